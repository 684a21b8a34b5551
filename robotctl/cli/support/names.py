"""Lists of the names of topics, services and nodes, as `ros2 topic list` and its kin print them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated

import typer

from robotctl.cli.terminal.text import printable
from robotctl.ipc.answers import NameAndTypes

Types = Annotated[bool, typer.Option("-t", "--show-types", help="Print the type beside each name.")]

All = Annotated[
    bool, typer.Option("-a", "--all", help="Also those whose name has a part that begins with _.")
]


def is_hidden(name: str) -> bool:
    """Return whether ROS tools leave a name out of their lists."""
    return "/_" in name


def shown(names: Sequence[NameAndTypes], every: bool) -> list[NameAndTypes]:
    """Return the names that are listed: all with `every`, else those that are not hidden."""
    return [each for each in names if every or not is_hidden(each["name"])]


def name_lines(names: Iterable[NameAndTypes], types: bool) -> Iterator[str]:
    """Yield a line for each name, with its types in brackets if wanted."""
    for each in names:
        kinds = f" [{', '.join(map(printable, each['types']))}]" if types else ""
        yield f"{printable(each['name'])}{kinds}"


def left_out_lines(count: int) -> Iterator[str]:
    """Yield a line that says how many names the daemon has left out, if any."""
    if count:
        yield f"and {count} more"
