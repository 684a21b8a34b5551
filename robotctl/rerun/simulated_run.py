"""What happened in a run, recorded or simulated: requests, refusals, and the results of drives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from robotctl.kernel.battery import counts_in_percent, level_of
from robotctl.kernel.finite import finite_or_none
from robotctl.kernel.lease import LeaseLost, LeaseRequested
from robotctl.kernel.lifecycle import LifecycleChanged
from robotctl.kernel.modes import Mode
from robotctl.kernel.parameter_change import ParameterRequested
from robotctl.kernel.params import BatteryScale
from robotctl.kernel.types import (
    BatteryReceived,
    DriveEnded,
    DriveReport,
    DriveRequested,
    Effect,
    Event,
    GuardedCommandReceived,
    HoldReceived,
    ModeRequested,
    OdomReceived,
    Reply,
    ResetRequested,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.closed_loop import Start
from robotctl.rerun.journal_values import read_effect, read_event

MAX_REQUESTS: Final = 100_000
"""The largest number of requests that are repeated; the result says if there were more."""

_WITHOUT_ID = (LeaseLost, GuardedCommandReceived, HoldReceived, LifecycleChanged)
_REPEATED = (
    *(ModeRequested, ResetRequested, DriveRequested, ParameterRequested, LeaseRequested),
    *_WITHOUT_ID,
)
_REQUESTS = frozenset(kind.__name__ for kind in _REPEATED)
_RESULTS = frozenset(kind.__name__ for kind in (DriveEnded, Reply))


@dataclass(slots=True)
class Run:
    """The requests of a run, its refusals, and the results of its drives by the request's id.

    Events without an id have negative ones. `start` is what the robot measured first.
    """

    begin_ns: int = 0
    end_ns: int = 0
    requests: dict[int, Event] = field(default_factory=dict)
    refused: dict[int, str] = field(default_factory=dict)
    drives: dict[int, dict[str, Any]] = field(default_factory=dict)
    start: Start = field(default_factory=Start)

    def take(self, entry: JournalEntry, scale: BatteryScale) -> None:
        """Take an entry of the journal.

        Raises:
            UnreadableFile: The entry is not one of this version.
        """
        if entry.kind is EntryKind.EFFECT:
            if entry.name in _RESULTS:
                self.effect(read_effect(entry), entry.t_ns)
        elif entry.name in _REQUESTS:
            self._request(read_event(entry))
        elif entry.name == OdomReceived.__name__ and self.start.odometry is None:
            event = read_event(entry)
            assert isinstance(event, OdomReceived)
            self.start = Start(event.odometry, self.start.battery)
        elif entry.name == BatteryReceived.__name__ and self.start.battery is None:
            event = read_event(entry)
            assert isinstance(event, BatteryReceived)
            level = level_of(event.level, counts_in_percent(event.level, False, scale))
            self.start = Start(self.start.odometry, level)

    def _request(self, event: Event) -> None:
        if len(self.requests) > MAX_REQUESTS:
            return
        if isinstance(event, _WITHOUT_ID):
            self.requests[-1 - len(self.requests)] = event
        else:
            assert isinstance(event, _REPEATED)
            self.requests[event.request_id] = event

    def effect(self, effect: Effect, t_ns: int) -> None:
        """Take an effect; a drive that began before the recording has no duration."""
        if isinstance(effect, Reply) and not effect.ok and effect.request_id in self.requests:
            self.refused[effect.request_id] = effect.message
        elif isinstance(effect, DriveEnded):
            request = self.requests.get(effect.request_id)
            duration_s = (t_ns - request.t_ns) / NS_PER_S if request else None
            report = effect.report
            if isinstance(request, DriveRequested) and request.course.held is not None:
                report = report.without_errors()
            self.drives[effect.request_id] = {
                "duration_s": duration_s,
                "completed": effect.completed,
                "reason": effect.reason,
                **figures(report),
            }

    def refused_drives(self) -> set[int]:
        """Return the ids of the refused requests for a motion."""
        return {each for each in self.refused if _starts_motion(self.requests[each])}


def _starts_motion(request: Event) -> bool:
    if isinstance(request, ModeRequested):
        return request.requested == Mode.MOVING.value
    return isinstance(request, DriveRequested)


def figures(report: DriveReport) -> dict[str, Any]:
    """Return the figures of a drive as JSON values, None for a figure that is unknown."""
    return {
        "laps": report.laps,
        "distance_m": report.distance_m,
        "cross_track_rms_m": finite_or_none(report.cross_track_rms_m),
        "cross_track_max_m": finite_or_none(report.cross_track_max_m),
        "closure_m": finite_or_none(report.closure_m),
    }
