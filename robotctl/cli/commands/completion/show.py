"""completion show: the script of a shell."""

from __future__ import annotations

from robotctl.cli.commands.completion.install import ShellName


def show(shell: ShellName) -> None:
    """Print the script, for a start file of your own.

    \b
    Examples:
      robotctl completion show zsh > ~/.zfunc/robotctl.zsh
    """
    print(shell.script, end="")
