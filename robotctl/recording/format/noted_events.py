"""The events that a recorder stores for effects of the kernel.

Readers of a recording do not import this module, because it imports the kernel.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType
from typing import Final

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import DriveEnded, Effect, ModeChanged
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import RecordedEvent

NOTED_MODES: Final[Mapping[Mode, EventKind]] = MappingProxyType(
    {Mode.EMERGENCY_STOP: EventKind.EMERGENCY_STOP, Mode.ERROR: EventKind.ERROR}
)
"""The modes whose start is stored as an event."""

_NONE: Final[Mapping[str, float]] = MappingProxyType({})


def noted_event(
    effect: Effect, log_ns: int, true_figures: Mapping[str, float] = _NONE
) -> RecordedEvent | None:
    """Return the event that a recorder stores for an effect, None if it stores none.

    `true_figures` are the true errors of a simulated drive, by their names in `RecordedEvent`.
    Values that are not finite are left out.
    """
    if isinstance(effect, ModeChanged) and effect.mode in NOTED_MODES:
        return RecordedEvent(NOTED_MODES[effect.mode], log_ns, effect.reason)
    if not isinstance(effect, DriveEnded):
        return None
    report = effect.report
    figures = {
        "cross_track_max_m": report.cross_track_max_m,
        "cross_track_rms_m": report.cross_track_rms_m,
        "heading_rms_rad": report.heading_rms_rad,
        "heading_max_rad": report.heading_max_rad,
        "closure_m": report.closure_m,
        "drive_s": report.duration_s,
        **true_figures,
    }
    known = {name: value for name, value in figures.items() if isfinite(value)}
    return RecordedEvent(EventKind.DRIVE_ENDED, log_ns, effect.reason, report.laps, **known)
