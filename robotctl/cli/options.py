"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer.core import TyperGroup

from robotctl.base.paths import ROBOT_VARIABLE
from robotctl.profiles import Profile

Robot = Annotated[
    str,
    typer.Option(
        "--robot",
        metavar="NAME",
        envvar=ROBOT_VARIABLE,
        show_envvar=True,
        help="Name of the robot; unless it is 'robot', also its ROS namespace.",
    ),
]

Namespace = Annotated[
    str | None,
    typer.Option("--namespace", metavar="/NAME", help="ROS namespace [default: by --robot]."),
]

ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Parameters: YAML, or a ROS parameter file."),
]

DomainId = Annotated[
    int | None,
    typer.Option("--domain-id", metavar="N", help="ROS domain [default: ROS_DOMAIN_ID, or 0]."),
]

ROS_WORD = "--ros-word"
"""The hidden option in which `registry.dispatch` passes each word of `--ros-args` to a command."""

RosWords = Annotated[list[str] | None, typer.Option(ROS_WORD, hidden=True)]

Reason = Annotated[
    str, typer.Option("--reason", metavar="TEXT", help="Why, for the journal and `why`.")
]

Json = Annotated[bool, typer.Option("--json", help="Print one line of JSON, for machines.")]

Types = Annotated[bool, typer.Option("-t", "--show-types", help="Print the type beside each name.")]

All = Annotated[
    bool, typer.Option("-a", "--all", help="Also those whose name has a part that begins with _.")
]


RecordingFile = Annotated[
    str,
    typer.Argument(
        metavar="FILE", help="An MCAP file, a recording's folder or name, a URL, or `last`."
    ),
]


def new_app(group: type[TyperGroup] = TyperGroup) -> typer.Typer:
    """Return a typer app without rich."""
    return typer.Typer(
        cls=group,
        add_completion=False,
        rich_markup_mode=None,  # rich would add 60 ms to every help screen
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80},
    )


def new_group(app: typer.Typer, name: str) -> typer.Typer:
    """Return a new group of commands with the name `name` in `app`."""
    group = new_app()
    app.add_typer(group, name=name)
    return group


_NAMES = ", ".join(profile.value for profile in Profile)

ProfileName = Annotated[
    Profile | None,
    typer.Option("--profile", metavar="ROBOT", help=f"Parameters of a known robot: {_NAMES}."),
]


def given_options(context: typer.Context) -> dict[str, str]:
    """Return {name: option} for each parameter that is given, such as {"rate": "--rate"}."""
    given = {}
    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            given[name] = parameter.opts[0]
    return given
