"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer.core import TyperGroup

from robotctl.cli.quick import ROBOT_VARIABLE

Robot = Annotated[
    str,
    typer.Option(
        "--robot",
        metavar="NAME",
        envvar=ROBOT_VARIABLE,
        show_envvar=True,
        help="The robot's name; any but 'robot' is its ROS namespace, too.",
    ),
]

ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Parameters: YAML, or a ROS parameter file."),
]

DomainId = Annotated[
    int | None,
    typer.Option("--domain-id", metavar="N", help="ROS domain [default: ROS_DOMAIN_ID, or 0]."),
]

Json = Annotated[bool, typer.Option("--json", help="Print one line of JSON, for machines.")]


def new_app(group: type[TyperGroup] = TyperGroup) -> typer.Typer:
    """An app of plain text: rich would cost every help screen 60 ms."""
    return typer.Typer(
        cls=group,
        add_completion=False,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80},
    )
