"""completion: let the Tab key complete commands, options, robots, recordings and topics."""

from __future__ import annotations

from robotctl.cli.commands.completion.install import install
from robotctl.cli.commands.completion.show import show
from robotctl.cli.commands.completion.words import words
from robotctl.cli.options import new_app

app = new_app()
group = new_app()
app.add_typer(group, name="completion")


@group.callback()
def completion() -> None:
    """Let the Tab key complete commands, options and names, in bash, zsh and fish.

    \b
    Examples:
      robotctl completion install bash
      robotctl completion show zsh
    """


group.command()(install)
group.command()(show)
group.command(hidden=True)(words)
