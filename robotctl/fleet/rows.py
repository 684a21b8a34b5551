"""The rows of an index: what a recording holds, in the columns of one table.

Times `..._ns` are since the epoch. None stands for what is not known. The column `kind` of the
table says which of these classes a row is of; a column that the class lacks is NULL.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """A recording: its size, its software, what happened in all, and its verdicts.

    `software` is the digest of the modules that decided and commanded, `parameters` the JSON of
    the kernel's first parameters. `check` and `verify` are the verdicts of `replay --check` and
    `verify`, and `check_says` the first thing that the check names.
    """

    kind: ClassVar[str] = "recording"

    robot: str
    start_ns: int
    duration_s: float
    size_bytes: int
    files: int
    messages: int
    lost: int
    version: str
    software: str
    parameters: str | None
    drives: int
    laps: int
    distance_m: float
    max_error_m: float | None
    stops: int
    check: str
    check_says: str | None
    verify: str


@dataclass(frozen=True, slots=True)
class DriveRow:
    """A drive, numbered from 1 in its recording, with the errors of its `DriveReport`.

    `wanted_laps` of 0 means until stopped. `ended` is the reason; it is None where the recording
    ends before the drive, and with it all that is known only at the end.
    """

    kind: ClassVar[str] = "drive"

    drive: int
    robot: str
    start_ns: int
    pattern: str | None
    wanted_laps: int | None
    asked_by: str
    duration_s: float | None = None
    laps: int | None = None
    completed: bool | None = None
    ended: str | None = None
    cause: str | None = None
    distance_m: float | None = None
    rms_error_m: float | None = None
    max_error_m: float | None = None
    closure_m: float | None = None
    rms_heading_rad: float | None = None
    max_heading_rad: float | None = None


@dataclass(frozen=True, slots=True)
class EventRow:
    """A change of mode, a refusal, or an event that the recording names (see `EventKind`)."""

    kind: ClassVar[str] = "event"

    event: str
    start_ns: int
    mode: str | None
    text: str
    cause: str | None = None


@dataclass(frozen=True, slots=True)
class TopicRow:
    """A topic: how much was recorded and lost, and at which mean rate."""

    kind: ClassVar[str] = "topic"

    topic: str
    type: str
    messages: int
    lost: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class SampleRow:
    """The robot at one moment: pose by odometry, command, distance from the reference, and mode."""

    kind: ClassVar[str] = "sample"

    drive: int | None
    start_ns: int
    mode: str
    x_m: float | None
    y_m: float | None
    theta_rad: float | None
    linear_mps: float | None
    angular_rps: float | None
    error_m: float | None


IndexRow = RecordingRow | DriveRow | EventRow | TopicRow | SampleRow

KINDS: tuple[type[Any], ...] = (RecordingRow, DriveRow, EventRow, TopicRow, SampleRow)

_SQL_TYPES = {"str": "VARCHAR", "int": "BIGINT", "float": "DOUBLE", "bool": "BOOLEAN"}

_SINGLE_PRECISION = ("x_m", "y_m", "theta_rad", "linear_mps", "angular_rps", "error_m")
"""Columns of the samples, the most of a file: 7 digits are enough for a question."""


def columns(kind: type[Any]) -> dict[str, str]:
    """Return the columns of a class of rows, with their types in SQL."""
    return {
        each.name: "FLOAT"
        if each.name in _SINGLE_PRECISION
        else _SQL_TYPES[str(each.type).removesuffix(" | None")]
        for each in fields(kind)
    }


def all_columns() -> dict[str, str]:
    """Return the columns of the table: `kind`, then those of each class."""
    found = {"kind": "VARCHAR"}
    for kind in KINDS:
        found |= columns(kind)
    return found
