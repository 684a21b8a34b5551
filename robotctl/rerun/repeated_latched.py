"""Counts the repeats of a topic's last message: each file begins with the last latched one."""

from __future__ import annotations

from robotctl.recording import RecordingInfo
from robotctl.recording.read.messages import Message


class RepeatedLatched:
    """The messages of a topic that are the one before them again, from a first snapshot on.

    Each file begins with a snapshot as well, so that there are no more repeats than snapshots, also
    where files were put together. A journal that was received has other snapshots.
    """

    def __init__(self, info: RecordingInfo) -> None:
        self._files = len(info.files)
        self._snapshots = 0
        self._last: Message | None = None
        self._count = 0

    def take(self, message: Message) -> bool:
        """Take a message; return whether it is the one before it again."""
        last, self._last = self._last, message
        is_again = last is not None and last._replace(log_ns=message.log_ns) == message
        self._count += is_again
        return is_again

    def count(self) -> None:
        """Count a repeat that comes before the message that it repeats."""
        self._count += 1

    def snapshot(self) -> None:
        """Take a snapshot."""
        self._snapshots += 1

    @property
    def excess(self) -> int:
        """The number of repeats that no file begins with."""
        return max(self._count - max(self._files, self._snapshots), 0)
