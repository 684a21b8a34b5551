"""The values that a parameter may take: modes, patterns, robots, recordings, topics ...

One table: by the metavar of the parameter. A look at the daemon or the disk that fails gives no
values.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from robotctl.errors import RobotctlError
from robotctl.ipc.client import Client

MAX_VALUES = 200

DEADLINE_S = 0.5
"""How long the daemon may take; a key press waits for it."""

ROBOT = "ROBOT"
"""The metavar of an argument that is a robot."""

_PLAIN = re.compile(r"[\w./+@%=-]+", re.ASCII)
"""What a shell takes as it is. Other values, which a neighbour could have chosen, are left out."""


def plain(values: Iterable[str], begin: str) -> list[str]:
    """Return the values that begin so, at most MAX_VALUES, without those a shell would expand."""
    return sorted({v for v in values if v.startswith(begin) and _PLAIN.fullmatch(v)})[:MAX_VALUES]


def _modes(robot: str) -> Iterable[str]:
    from robotctl.mode_names import MODES

    return MODES


def _robots(robot: str) -> Iterable[str]:
    from robotctl.cli.support.robots import names

    return names()


def _recordings(robot: str) -> Iterable[str]:
    from robotctl.cli.support.recording_paths import LAST, recordings_folder, recordings_of

    found = recordings_of(None, recordings_folder(None, None))
    return [LAST, *(path.name for path in found)] if found else []


def _patterns(robot: str) -> Iterable[str]:
    from robotctl.cli.support.words_of_other_tools import PATTERN_WORDS

    return PATTERN_WORDS


def _topics(robot: str) -> Iterable[str]:
    from robotctl.ipc.method_names import GRAPH

    with Client(robot) as client:
        return [topic["name"] for topic in client.call(GRAPH, deadline_s=DEADLINE_S)["topics"]]


def _parameters(robot: str) -> Iterable[str]:
    from robotctl.ipc.method_names import PARAM_LIST

    with Client(robot) as client:
        answer = client.call(PARAM_LIST, deadline_s=DEADLINE_S)
        return [parameter["key"] for parameter in answer["parameters"]]


BY_METAVAR: Mapping[str, Callable[[str], Iterable[str]]] = MappingProxyType(
    {
        "MODE": _modes,
        ROBOT: _robots,
        "FILE": _recordings,
        "RECORDING": _recordings,
        "PATTERN": _patterns,
        "TOPIC": _topics,
        "KEY": _parameters,
    }
)


def values_for(metavar: str, robot: str, begin: str) -> list[str]:
    """Return the values for a parameter with this metavar that begin so."""
    look = BY_METAVAR.get(metavar.strip("[]."))
    if look is None:
        return []
    try:
        return plain(look(robot), begin)
    except (RobotctlError, OSError):
        return []
