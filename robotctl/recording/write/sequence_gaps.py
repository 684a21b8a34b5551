"""Messages that publishers sent and we did not receive: sequence gaps, per publisher."""

from __future__ import annotations

from dataclasses import dataclass, field

MAX_PUBLISHERS = 1024
"""Maximum number of remembered publishers per topic; beyond that the oldest is forgotten."""

MAX_MISSING = 64
"""Missing numbers remembered per publisher, because a message that arrives late is not lost."""


@dataclass(slots=True)
class SequenceGaps:
    """The gaps in the sequence numbers of one topic.

    `expected` maps each publisher (its gid) to its next sequence number. The hot path compares with
    it and advances it itself, and calls `note` in all other cases. Sequence number 0 means that the
    publisher does not count its messages.
    """

    expected: dict[bytes, int] = field(default_factory=dict)
    lost: int = 0
    """Messages missing between two that were received."""

    unseen: int = 0
    """Messages that publishers sent before the first one received from them."""

    _missing: dict[bytes, set[int]] = field(default_factory=dict)

    def note(self, gid: bytes, sequence: int) -> None:
        """Count a message that is not the expected one, and expect its successor."""
        if sequence <= 0:
            return
        expected = self.expected.get(gid)
        if expected is None:
            if len(self.expected) >= MAX_PUBLISHERS:
                oldest = next(iter(self.expected))
                del self.expected[oldest]
                self._missing.pop(oldest, None)
            self.unseen += sequence - 1
        elif sequence > expected:
            self.lost += sequence - expected
            self._remember(gid, range(expected, sequence))
        elif sequence < expected:
            missing = self._missing.get(gid, set())
            if sequence in missing:
                missing.discard(sequence)
                self.lost -= 1
                return
            missing.clear()  # the publisher restarted with its old gid
        self.expected[gid] = sequence + 1

    def _remember(self, gid: bytes, gap: range) -> None:
        missing = self._missing.setdefault(gid, set())
        missing.update(gap[-MAX_MISSING:])
        while len(missing) > MAX_MISSING:
            missing.discard(min(missing))
