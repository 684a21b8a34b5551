"""What the command line asks of the process that plays, and what that process says back."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Self

from robotctl.errors import UsageError

AS_FAST_AS_POSSIBLE = "max"
MAX_RATE = 10_000.0
MIN_RATE = 0.001


@dataclass(frozen=True, slots=True)
class Job:
    """What to play, and how; `rate` None is as fast as subscribers take it.

    Times are of the recording: play from `start_offset_s` after its first message, for
    `duration_s`. No `topics` means all. `domain_id` None leaves the choice to the robot's daemon.
    """

    file: Path
    robot: str
    domain_id: int | None = None
    rate: float | None = 1.0
    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    start_offset_s: float = 0.0
    duration_s: float | None = None
    loop: bool = False
    force: bool = False
    debug: bool = False

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self) | {"file": str(self.file)})

    @classmethod
    def from_json(cls, line: str) -> Self:
        """The job in a line of `to_json`."""
        fields: dict[str, Any] = json.loads(line)
        for name in ("topics", "exclude"):
            fields[name] = tuple(fields[name])
        return cls(**fields | {"file": Path(fields["file"])})


def parse_rate(text: str) -> float | None:
    """The rate of `--rate`, None for `max`. Raises UsageError."""
    if text.strip().lower() == AS_FAST_AS_POSSIBLE:
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = 0.0
    if not MIN_RATE <= rate <= MAX_RATE:
        raise UsageError(
            f"--rate {text}: use a number from {MIN_RATE:g} to {MAX_RATE:g}, "
            f"or {AS_FAST_AS_POSSIBLE}"
        )
    return rate


def check_seconds(option: str, value: float, *, positive: bool = False) -> float:
    """Return `value` if it is a span of time; raises UsageError."""
    if not isfinite(value) or value < 0 or (positive and value == 0):
        raise UsageError(
            f"{option} {value:g}: give seconds, {'above' if positive else 'at least'} 0"
        )
    return value
