"""The typer application; a command's module is imported only when it is needed."""

from __future__ import annotations

import importlib
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from robotctl import __version__
from robotctl.base import retired, ros_arguments
from robotctl.base.errors import IN_PARENTHESES, UsageError
from robotctl.cli.options import ROS_WORD, new_app

SECTIONS = {
    "Without a robot": ("demo", "sim", "doctor", "completion"),
    "The daemon": ("start", "status", "ps", "watch", "view", "logs", "stop", "boot", "config"),
    "The robot": (
        "preflight",
        "commission",
        "drive",
        "teleop",
        "set-mode",
        "estop",
        "reset",
        "lease",
        "param",
    ),
    "ROS": ("topic", "node", "service"),
    "Recordings": (
        *(
            "record",
            "mark",
            "recordings",
            "info",
            "clip",
            "recover",
            "convert",
            "export",
            "replay",
            "why",
            "report",
            "plot",
        ),
        *("verify", "key", "evidence"),
    ),
    "Many recordings": ("index", "find", "gate", "sync"),
}
"""The sections of the help, with their commands."""

COMMANDS = tuple(name for names in SECTIONS.values() for name in names)


_SHARED_MODULES = {
    "demo": "sim",
    "stop": "start",
    **dict.fromkeys(("ps", "watch", "view"), "status"),
    "config": "param",
    **dict.fromkeys(("preflight", "estop", "reset"), "set-mode"),
    "service": "node",
    "mark": "record",
    "recordings": "info",
    **dict.fromkeys(("recover", "convert"), "clip"),
    "plot": "report",
    "key": "verify",
    "index": "find",
}
"""The commands that are in the module of another command."""


def module_of(command: str) -> str:
    """Return the name of a command's module in `commands`, such as "recordings.verify"."""
    name = _SHARED_MODULES.get(command, command).replace("-", "_")
    in_folder = command in SECTIONS["Recordings"] + SECTIONS["Many recordings"]
    return f"recordings.{name}" if in_folder else name


OTHER_WORDS = {
    "list": "`robotctl ps` lists robots, `robotctl recordings` recordings, "
    "`robotctl topic list` topics",
    "kill": "`robotctl estop` stops the robot at once, `robotctl stop` ends the daemon",
    "run": "`robotctl start` starts the daemon, `robotctl drive` drives",
    "launch": "`robotctl start` starts the daemon",
    "bag": "`robotctl start` records everything; see `robotctl recordings`, `robotctl replay`",
    "play": "`robotctl replay FILE` plays a recording to ROS",
    "csv": "`robotctl export FILE --topic TOPIC` writes a topic as CSV",
    "rm": "`robotctl recordings rm NAME` removes a recording",
    "delete": "`robotctl recordings rm NAME` removes a recording",
    "ls": "`robotctl recordings` lists recordings, `robotctl ps` robots",
    "echo": "`robotctl topic echo TOPIC` prints messages",
    "hz": "`robotctl topic hz TOPIC` measures the rate",
    "call": "`robotctl service call NAME` calls a service",
    "move": "`robotctl drive` drives",
    "go": "`robotctl drive` drives",
    "forward": "`robotctl drive line` drives straight ahead",
    "halt": "`robotctl set-mode idle` ramps the robot down, `robotctl estop` stops it at once",
    "pause": "`robotctl set-mode idle` ramps the robot down",
    "shutdown": "`robotctl stop` ends the daemon",
    "restart": "`robotctl stop`, then `robotctl start`",
    "mode": "`robotctl status` shows the mode, `robotctl set-mode` asks for one",
    "log": "`robotctl logs` prints the log of the daemon",
    "params": "`robotctl param list` lists the parameters",
    "check": "`robotctl replay FILE --check` checks a recording",
    "figure8": "`robotctl drive figure-eight`",
}
"""Words of ros2 and other tools, with the commands of robotctl that do the same."""


def other_words() -> dict[str, str]:
    """Return the advice for each word that is no command: OTHER_WORDS, and names of motions."""
    from robotctl.cli.commands.drive import MOTIONS

    return OTHER_WORDS | {word: f"`robotctl drive {word}`" for word in MOTIONS}


class LazyGroup(TyperGroup):
    """A group that imports only the called command."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return every command, in the order of the help."""
        return list(COMMANDS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands in their sections, each with the first sentence of its help."""
        width = max(map(len, COMMANDS))
        for title, names in SECTIONS.items():
            commands = [self.get_command(ctx, name) for name in names]
            with formatter.section(title):
                formatter.write_dl(
                    [
                        (f"{command.name:{width}}", command.get_short_help_str(formatter.width))
                        for command in commands
                    ]
                )

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command `cmd_name`, or None if there is none.

        Raises:
            UsageError: The name is retired or in `other_words`; the error names the right command.
        """
        if cmd_name not in COMMANDS:
            if cmd_name in retired.COMMANDS:
                raise UsageError(f"{cmd_name!r} is retired", retired.COMMANDS[cmd_name])
            if cure := other_words().get(cmd_name):
                raise UsageError(f"No such command {cmd_name!r}", cure)
            # Load all commands: typer suggests one of them.
            self.commands = {name: self.get_command(ctx, name) for name in COMMANDS}
            return None
        module = importlib.import_module(f"robotctl.cli.commands.{module_of(cmd_name)}")
        group = typer.main.get_group(module.app)
        return group.commands[cmd_name]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"robotctl {__version__}")
        raise typer.Exit


app = new_app(LazyGroup)


@app.callback(
    epilog="Exit codes: 0 ok, 1 internal, 2 usage, 3 no daemon, 4 refused, 5 already running, "
    "6 unreadable file, 7 decided differently, 8 recovered with loss, 130 interrupted."
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
    """Parse and run one command line.

    Raises:
        UsageError: typer could not parse the command line.
    """
    command = typer.main.get_command(app)
    arguments, ros_words = ros_arguments.split(arguments)
    arguments += [f"{ROS_WORD}={word}" for word in ros_words]
    try:
        with command.make_context("robotctl", arguments) as context:
            command.invoke(context)
    except typer.Exit as leaving:
        if leaving.exit_code:
            raise
    except Exception as error:
        # typer's usage errors have no public base class in all its versions, only this method.
        describe = getattr(error, "format_message", None)
        if describe is None:
            raise
        where = getattr(getattr(error, "ctx", None), "command_path", "robotctl")
        words = where.removeprefix("robotctl ")
        option = (words, getattr(error, "option_name", ""))
        if option in retired.OPTIONS:
            raise UsageError(f"{option[1]} is retired", retired.OPTIONS[option]) from error
        text = " ".join(describe().split()).rstrip(".")
        if words in retired.ARGUMENTS and "unexpected extra argument" in text:
            raise UsageError(
                f"the argument of {words} is retired", retired.ARGUMENTS[words]
            ) from error
        raise UsageError(text, f"see: {where} --help", sentence=IN_PARENTHESES) from error
