"""The job that `robotctl view` sends to its process, as one line of JSON."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from typing import Final, Self

_ORIGIN: Final = re.compile(r"[a-z][a-z0-9+.-]*://[^\sA-Z/?#@*]+|file://|null")
"""The form of browsers' origins: a scheme and a host, in lower case, without a path."""


def is_origin(text: str) -> bool:
    """Return whether `text` has the form of a browser's Origin header, such as http://host:80."""
    return _ORIGIN.fullmatch(text) is not None


@dataclass(frozen=True, slots=True)
class LiveTarget:
    """A running daemon and its ROS domain."""

    robot: str
    daemon_pid: int
    """The process whose end ends the view, 0 if unknown."""
    namespace: str
    domain_id: int


@dataclass(frozen=True, slots=True)
class ViewJob:
    """The settings of a live view."""

    live: LiveTarget
    host: str = "127.0.0.1"
    port: int | None = None
    """None means DEFAULT_PORT or, if that is in use, a free port."""
    origins: tuple[str, ...] = ()
    """Origins that may connect in addition to KNOWN_ORIGINS."""
    control: bool = False
    """Whether viewers may stop the robot."""
    lease: str = ""
    """The token of the lease for viewers to drive, "" if they may not."""
    outlives_stdin: bool = False
    """Whether the process goes on when its stdin is closed."""

    def to_json(self) -> str:
        """Return the job as one line of JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str | bytes) -> Self:
        """Return the job that `to_json` wrote in `line`."""
        fields = json.loads(line)
        live = LiveTarget(**fields.pop("live"))
        return cls(live=live, origins=tuple(fields.pop("origins")), **fields)
