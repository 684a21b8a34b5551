"""The group `boot`, to which each command adds itself."""

from __future__ import annotations

import getpass
import os
from pathlib import Path
from typing import Annotated

import typer

from robotctl.cli.options import new_app

app = new_app()
group = new_app()
app.add_typer(group, name="boot")

System = Annotated[
    bool, typer.Option("--system", help="A unit of the machine, not of the user; needs root.")
]
UnitUser = Annotated[
    str, typer.Option("--user", metavar="USER", help="Who runs it [default: you].")
]
Arguments = Annotated[
    list[str] | None,
    typer.Argument(metavar="[-- OPTION...]", help="Options of start, such as --no-sim."),
]


@group.callback()
def boot() -> None:
    """Start the daemon at boot, by a systemd unit.

    \b
    Examples:
      robotctl boot show -- --no-sim --config robot.yaml
      robotctl boot install -- --no-sim --config robot.yaml
      robotctl boot remove
    """


def start_arguments(arguments: list[str] | None) -> tuple[str, ...]:
    """Return the options of start with absolute paths: a unit has another working folder.

    Raises:
        UsageError: They begin a motion or leave the foreground.
    """
    from robotctl.errors import UsageError

    words = tuple(arguments or ())
    for word in words:
        if word.partition("=")[0] in ("--drive", "--foreground", "--json", "--robot"):
            cure = "nothing moves at a boot" if word.startswith("--drive") else "leave it out"
            raise UsageError(f"{word} in a unit", cure)
    before = ("", *words)
    return tuple(
        str(Path(word).absolute()) if previous in ("--config", "--recordings") else word
        for previous, word in zip(before, words, strict=False)
    )


def me() -> str:
    """Return the name of the user, under sudo of the one who called it."""
    return os.environ.get("SUDO_USER") or getpass.getuser()
