"""The kinds of events that the files of a recording name; imports nothing that is slow."""

from __future__ import annotations

from enum import StrEnum


class EventKind(StrEnum):
    """The kind of an event."""

    EMERGENCY_STOP = "estop"
    ERROR = "error"
    MARK = "mark"
    DRIVE_ENDED = "drive ended"


CLIP_KINDS = tuple(kind for kind in EventKind if kind is not EventKind.DRIVE_ENDED)
"""The kinds that a clip can be about."""
