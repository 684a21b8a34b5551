"""The events of a recording as MCAP metadata records, which the summary lists."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Self

from mcap.records import Metadata

from robotctl.recording.format.names import EVENT_RECORD, EventKind
from robotctl.recording.format.records import MAX_TIME_NS

MAX_LAPS = 1_000_000
"""Maximum number of laps in a record."""

ERRORS = (
    "cross_track_max_m",
    "true_cross_track_rms_m",
    "true_cross_track_max_m",
    "cross_track_rms_m",
    "heading_rms_rad",
    "heading_max_rad",
    "closure_m",
    "true_heading_rms_rad",
    "true_heading_max_rad",
    "true_closure_m",
)
"""Names of a drive's tracking errors in a metadata record. Unknown errors are left out."""

_DRIVE_FIGURES = (*ERRORS, "drive_s")


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    """One event; `log_ns` is its time [ns since the epoch].

    Only the end of a drive has `laps`, a duration and errors (see kernel.types.DriveReport).
    Unknown values are None. The `true_*` errors are only known of a simulated robot.
    """

    kind: EventKind
    log_ns: int
    text: str
    laps: int = 0
    cross_track_max_m: float | None = None
    true_cross_track_rms_m: float | None = None
    true_cross_track_max_m: float | None = None
    cross_track_rms_m: float | None = None
    heading_rms_rad: float | None = None
    heading_max_rad: float | None = None
    closure_m: float | None = None
    true_heading_rms_rad: float | None = None
    true_heading_max_rad: float | None = None
    true_closure_m: float | None = None
    drive_s: float | None = None

    def values(self) -> Mapping[str, str]:
        """Return the event as the values of a metadata record."""
        values = {"kind": self.kind.value, "log_ns": str(self.log_ns), "text": self.text}
        if self.kind is EventKind.DRIVE_ENDED:
            values["laps"] = str(self.laps)
            figures: dict[str, float | None] = {n: getattr(self, n) for n in _DRIVE_FIGURES}
            values |= {name: repr(each) for name, each in figures.items() if each is not None}
        return values

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> Self:
        """Return the event from the values of a metadata record.

        Raises:
            ValueError: A value is not allowed.
            KeyError: A value is missing.
        """
        log_ns, laps = int(values["log_ns"]), int(values.get("laps", 0))
        if not (0 <= log_ns <= MAX_TIME_NS and 0 <= laps <= MAX_LAPS):
            raise ValueError("a number is out of range")
        figures = {name: float(values[name]) for name in _DRIVE_FIGURES if name in values}
        if not all(map(isfinite, figures.values())):
            raise ValueError("a figure is not finite")
        return cls(EventKind(values["kind"]), log_ns, values["text"], laps, **figures)


def events_in(metadata: Iterable[Metadata]) -> list[RecordedEvent]:
    """Return the readable events in `metadata`, in its order."""
    events = []
    for record in metadata:
        if record.name == EVENT_RECORD:
            try:
                events.append(RecordedEvent.from_values(record.metadata))
            except (KeyError, ValueError):  # written by a later version
                continue
    return events
