"""The figures of a recording: what a reader wants to know first."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot, isfinite, sqrt

from robotctl.recording.format.ledger_record import read_ledger
from robotctl.report.recorded import Recorded
from robotctl.report.traces import Traces


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure: its key in `--json`, its name, its value (None: not known), format and unit.

    A value that is not finite is not known either: a recording may hold any number.
    """

    key: str
    name: str
    value: float | None
    form: str
    unit: str

    @property
    def text(self) -> str:
        """The value with its unit, or "unknown"."""
        if self.value is None:
            return "unknown"
        return f"{self.value:{self.form}} {self.unit}".rstrip()


def figures_of(recorded: Recorded) -> list[Figure]:
    """Return the figures of a recording, in the order in which they are shown."""
    traces, info = recorded.traces, recorded.info
    ledger = read_ledger(info.metadata).values()
    lost = sum(counts.get("lost", 0) + counts.get("dropped", 0) for counts in ledger)
    rms_m, most_m = _cross_track(traces)
    speed = traces.linear
    figures = [
        Figure("duration_s", "Duration", info.duration_s, ".1f", "s"),
        Figure("drives", "Drives", len(traces.drives) if recorded.has_journal else None, "d", ""),
        Figure("distance_m", "Distance", _distance(traces), ".2f", "m"),
        Figure("cross_track_rms_m", "Off track, RMS", rms_m, ".3f", "m"),
        Figure("cross_track_max_m", "Off track, at most", most_m, ".3f", "m"),
        Figure("speed_max_mps", "Speed, at most", _largest(speed.least, speed.most), ".2f", "m/s"),
        Figure("battery_begin", "Battery, begin", _first(traces), ".1f", "%"),
        Figure("battery_end", "Battery, end", _last(traces), ".1f", "%"),
        Figure("tick_late_max_ms", "Tick late, at most", traces.lateness.most, ".1f", "ms"),
        Figure("messages", "Messages", info.message_count, "d", ""),
        Figure("lost", "Messages lost", lost if ledger else None, "d", ""),
    ]
    return [
        each if each.value is None or isfinite(each.value) else replace(each, value=None)
        for each in figures
    ]


def _distance(traces: Traces) -> float | None:
    if traces.drives:
        return sum(drive.report.distance_m for drive in traces.drives)
    places = traces.driven.whole()
    if not places:
        return None
    return sum(hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(places))


def _cross_track(traces: Traces) -> tuple[float | None, float | None]:
    """Return the root mean square over all drives, by their duration, and the largest error."""
    reports = [
        report
        for report in (drive.report for drive in traces.drives)
        if isfinite(report.duration_s) and isfinite(report.cross_track_rms_m)
    ]
    time_s = sum(report.duration_s for report in reports)
    rms_m = None
    if time_s > 0.0:
        squares = (
            report.cross_track_rms_m * report.cross_track_rms_m * report.duration_s
            for report in reports
        )
        rms_m = sqrt(max(sum(squares) / time_s, 0.0))
    return rms_m, traces.error.most


def _largest(least: float | None, most: float | None) -> float | None:
    return None if least is None or most is None else max(abs(least), abs(most))


def _first(traces: Traces) -> float | None:
    columns = traces.battery.columns
    return columns[0].first if columns else None


def _last(traces: Traces) -> float | None:
    columns = traces.battery.columns
    return columns[-1].last if columns else None
