"""What a report draws of a recording: paths, values over time, modes, moments, rates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from robotctl.kernel.types import DriveReport
from robotctl.report.driven import ThinnedPath, is_on_earth
from robotctl.report.series import Series

MAX_SPANS: Final = 150
MAX_MOMENTS: Final = 100
MAX_DRIVES: Final = 50
MAX_WANTED_POINTS: Final = 8_000
"""How much of each is kept; `Traces.left_out` counts the rest."""

RATE_COLUMNS: Final = 60
"""Columns of the small picture of a topic's rate."""

Point = tuple[float, float]


@dataclass(slots=True)
class ModeSpan:
    """A time in one mode, and why it began."""

    begin_s: float
    end_s: float
    mode: str
    reason: str


@dataclass(frozen=True, slots=True)
class TracedMoment:
    """Something that happened: its kind in a word, and what is known of it."""

    t_s: float
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class EndedDrive:
    """A drive that ended, and its figures."""

    t_s: float
    reason: str
    report: DriveReport


class Rates:
    """How many messages of each topic came in each part of the recording, and the longest pause."""

    def __init__(self, duration_s: float) -> None:
        self.counts: dict[str, list[int]] = {}
        self.pauses_s: dict[str, float] = {}
        self._last_s: dict[str, float] = {}
        self._per_s = RATE_COLUMNS / duration_s if duration_s > 0.0 else 0.0

    def add(self, topic: str, t_s: float) -> None:
        """Count a message."""
        counts = self.counts.get(topic)
        if counts is None:
            counts = self.counts[topic] = [0] * RATE_COLUMNS
        counts[min(max(int(t_s * self._per_s), 0), RATE_COLUMNS - 1)] += 1
        pause_s = t_s - self._last_s.get(topic, t_s)
        self.pauses_s[topic] = max(self.pauses_s.get(topic, 0.0), pause_s)
        self._last_s[topic] = t_s


@dataclass(slots=True)
class Traces:
    """The traces of one recording; times are in seconds from its first message."""

    duration_s: float
    driven: ThinnedPath = field(default_factory=ThinnedPath)
    wanted: list[list[Point]] = field(default_factory=list)
    modes: list[ModeSpan] = field(default_factory=list)
    moments: list[TracedMoment] = field(default_factory=list)
    drives: list[EndedDrive] = field(default_factory=list)
    left_out: int = 0
    """The modes, moments, drives and wanted paths that are not kept."""

    commanded_linear: Series = field(init=False)
    commanded_angular: Series = field(init=False)
    linear: Series = field(init=False)
    angular: Series = field(init=False)
    error: Series = field(init=False)
    battery: Series = field(init=False)
    lateness: Series = field(init=False)
    rates: Rates = field(init=False)

    def __post_init__(self) -> None:
        self.commanded_linear = Series(self.duration_s)
        self.commanded_angular = Series(self.duration_s)
        self.linear = Series(self.duration_s)
        self.angular = Series(self.duration_s)
        self.error = Series(self.duration_s)
        self.battery = Series(self.duration_s)
        self.lateness = Series(self.duration_s)
        self.rates = Rates(self.duration_s)

    def enter_mode(self, t_s: float, mode: str, reason: str) -> None:
        """Note a mode from a time on."""
        if self.modes:
            self.modes[-1].end_s = t_s
            if self.modes[-1].mode == mode and self.modes[-1].reason == reason:
                return
        if self._has_room(self.modes, MAX_SPANS):
            self.modes.append(ModeSpan(t_s, t_s, mode, reason))

    def happened(self, t_s: float, kind: str, text: str) -> None:
        """Note a moment."""
        if self._has_room(self.moments, MAX_MOMENTS):
            self.moments.append(TracedMoment(t_s, kind, text))

    def drive_ended(self, drive: EndedDrive) -> None:
        """Note the end of a drive."""
        if self._has_room(self.drives, MAX_DRIVES):
            self.drives.append(drive)

    def want(self, outline: list[Point]) -> None:
        """Note a wanted path; one that leads nowhere is left out."""
        has_room = sum(map(len, self.wanted)) + len(outline) <= MAX_WANTED_POINTS
        if outline and has_room and all(is_on_earth(x, y) for x, y in outline):
            self.wanted.append(outline)
        else:
            self.left_out += 1

    def close(self) -> None:
        """Let the last mode last to the end."""
        if self.modes:
            self.modes[-1].end_s = max(self.duration_s, self.modes[-1].begin_s)

    def series(self) -> Iterator[Series]:
        """Yield every series."""
        yield from (self.commanded_linear, self.linear, self.commanded_angular, self.angular)
        yield from (self.error, self.battery, self.lateness)

    def _has_room(self, kept: Sequence[object], limit: int) -> bool:
        if len(kept) < limit:
            return True
        self.left_out += 1
        return False
