"""Options that the commands on topics share."""

from __future__ import annotations

from typing import Annotated

import typer

RecordedFile = Annotated[
    str,
    typer.Option(
        "--file", metavar="FILE", help="A recording instead of ROS: its path, its name, or `last`."
    ),
]

TopicName = Annotated[
    str, typer.Argument(metavar="TOPIC", help="The topic; without a leading / it is the robot's.")
]

TypeName = Annotated[
    str,
    typer.Option(
        "--type", metavar="TYPE", help="Its type, where it has several or no publisher yet."
    ),
]
