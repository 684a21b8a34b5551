"""The counters of the loss ledger."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final


@dataclass(slots=True)
class MessageCounts:
    """What happened to messages: received = written + queued + dropped."""

    received: int = 0
    written: int = 0
    queued: int = 0
    dropped: int = 0
    lost: int = 0
    """Sent between two messages that were received: gaps in a publisher's sequence numbers."""

    unseen: int = 0
    """Sent by a publisher before its first message that was received."""

    not_repeated: int = 0
    """Latched messages that later files do not repeat, for lack of memory or room in the file."""

    throttled: int = 0
    """Left out before the recorder received them: throttled, or because the disk is full soon."""


COUNTERS: Final = tuple(field.name for field in fields(MessageCounts))
