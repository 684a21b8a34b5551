"""completion install: make the shell complete from its next start on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from robotctl.cli.completion.scripts import Shell
from robotctl.cli.options import Json
from robotctl.cli.support.answer import print_answer
from robotctl.cli.terminal.text import short_path

ShellName = Annotated[Shell, typer.Argument(help="The shell.")]


def install(shell: ShellName, as_json: Json = False) -> None:
    """Add the completion to the file that the shell reads when it starts.

    \b
    Examples:
      robotctl completion install bash
    """
    from robotctl.cli.completion.installation import install as install_into

    path = install_into(shell, Path.home())
    told = f"{short_path(path)} has the completion; it works in the next {shell.value}"
    print_answer({"shell": shell.value, "path": str(path)}, [told], as_json=as_json)
