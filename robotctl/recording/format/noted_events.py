"""The effects of the kernel that become events, and the event message of Foxglove."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType
from typing import Final

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import DriveEnded, Effect, ModeChanged
from robotctl.messages.definition import parse_definition
from robotctl.messages.values import encode
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
    """Return the event to record for an effect, None for an effect without one.

    `true_figures` has the true errors of a simulated drive, by their names in `RecordedEvent`.
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


TOPIC: Final = "robotctl/events"
TYPE_NAME: Final = "foxglove_msgs/msg/Event"
"""Specification: https://docs.foxglove.dev/docs/sdk/schemas/event."""

_LINE: Final = "=" * 80

DEFINITION: Final = f"""\
# Something that happened, from its beginning to its end
builtin_interfaces/Time start_time
builtin_interfaces/Time end_time
# What it was; each key stands once
foxglove_msgs/KeyValuePair[] metadata
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{_LINE}
MSG: foxglove_msgs/KeyValuePair
string key
string value
"""


_EVENT: Final = parse_definition(TYPE_NAME, DEFINITION)


def encode_event(start_ns: int, end_ns: int, metadata: Mapping[str, str]) -> bytes:
    """Return a serialized Event message of Foxglove (CDR). Times are since the epoch."""
    start, end = ({"sec": ns // NS_PER_S, "nanosec": ns % NS_PER_S} for ns in (start_ns, end_ns))
    pairs = [{"key": key, "value": value} for key, value in metadata.items()]
    return encode(_EVENT, {"start_time": start, "end_time": end, "metadata": pairs})
