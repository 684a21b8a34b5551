"""The typer application. A command's module is imported when it is called, or for the help."""

from __future__ import annotations

import importlib
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from robotctl import __version__
from robotctl.cli.options import new_app
from robotctl.errors import UsageError

MODULES = {
    "start": "lifecycle",
    "stop": "lifecycle",
    "status": "modes",
    "watch": "watch",
    "set-mode": "modes",
    "estop": "modes",
    "reset": "modes",
    "drive": "drive",
    "logs": "lifecycle",
    "mark": "record",
    "record": "record",
    "recordings": "recordings",
    "info": "info",
    "why": "why",
    "recover": "recover",
    "clip": "clip",
    "replay": "replay",
    "sim": "sim",
    "demo": "demo",
}
"""Each command, in the order of the help, and the module of this package that declares it."""


class LazyGroup(TyperGroup):
    """Builds no command but the one that is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Every command, in the order of the table."""
        return list(MODULES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of that name, or None; an unknown name loads all, for a suggestion."""
        if cmd_name not in MODULES:
            self.commands = {name: self.get_command(ctx, name) for name in MODULES}
            return None
        module = importlib.import_module(f"robotctl.cli.{MODULES[cmd_name]}")
        group = typer.main.get_group(module.app)
        return group.commands[cmd_name]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"robotctl {__version__}")
        raise typer.Exit


app = new_app(LazyGroup)


@app.callback(
    epilog="Try it without a robot: robotctl demo. Exit codes: 0 ok, 2 usage, 3 no daemon, "
    "4 refused, 5 already running, 6 unreadable file, 7 decided differently, "
    "8 recovered with loss, 130 interrupted."
)
def root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error (anywhere in the line).")
    ] = False,
) -> None:
    """Drive a ROS 2 robot, stop it safely, record everything."""


def dispatch(arguments: list[str]) -> None:
    """Parse and carry out one command line.

    Raises:
        UsageError: What typer says against it, with the help to look at.
    """
    command = typer.main.get_command(app)
    try:
        with command.make_context("robotctl", arguments) as context:
            command.invoke(context)
    except typer.Exit as leaving:
        if leaving.exit_code:
            raise
    except Exception as error:
        # typer's usage errors share no public base over its versions, but this method.
        describe = getattr(error, "format_message", None)
        if describe is None:
            raise
        where = getattr(getattr(error, "ctx", None), "command_path", "robotctl")
        text = f"{' '.join(describe().split()).rstrip('.')} (see: {where} --help)"
        raise UsageError(text) from error
