"""What `robotctl view` asks its process for, as one line of JSON."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from typing import Final, Self

_ORIGIN: Final = re.compile(r"[a-z][a-z0-9+.-]*://[^\sA-Z/?#@*]+|file://|null")
"""What browsers send: a scheme and a host, in small letters, without a path."""


def is_origin(text: str) -> bool:
    """Return whether a page can have this origin; any other text would admit nobody."""
    return _ORIGIN.fullmatch(text) is not None


@dataclass(frozen=True, slots=True)
class LiveTarget:
    """A running daemon and its ROS domain."""

    robot: str
    daemon_pid: int
    """Its end ends the view; 0 for a daemon whose pid is not known."""
    namespace: str
    domain_id: int


@dataclass(frozen=True, slots=True)
class ViewJob:
    """What to show, and where to listen."""

    live: LiveTarget
    host: str = "127.0.0.1"
    port: int | None = None
    """None is the usual port, or a free one where that is taken."""
    origins: tuple[str, ...] = ()
    """Pages that may connect in addition to those that are known."""
    control: bool = False
    """Whether viewers may stop the robot."""
    lease: str = ""
    """The token of the lease with which viewers may drive, too."""
    outlives_stdin: bool = False
    """Whether the process goes on when its stdin is closed; else it ends."""

    def to_json(self) -> str:
        """Return the line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str | bytes) -> Self:
        """Return the job of a line that `to_json` made."""
        fields = json.loads(line)
        live = LiveTarget(**fields.pop("live"))
        return cls(live=live, origins=tuple(fields.pop("origins")), **fields)
