"""The counts and latched messages of each channel of a recorder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from robotctl.recording.format.disk import Buffer
from robotctl.recording.format.records import MAX_SEQUENCE, MAX_TIME_NS
from robotctl.recording.format.topics import Topic, TopicStats

MAX_PUBLISHERS = 1024
"""Maximum number of remembered publishers per topic. The oldest is forgotten first."""

MAX_MISSING = 64
"""Maximum number of missing messages per publisher that may still arrive."""


@dataclass(slots=True)
class SequenceGaps:
    """The gaps in the sequence numbers of one topic.

    `expected` has the next number by publisher (gid). `Recorder.write` increases it, or calls
    `note` for any other number. Number 0 means that the publisher does not count.
    """

    expected: dict[bytes, int] = field(default_factory=dict)
    lost: int = 0
    """Messages missing between two received ones."""

    unseen: int = 0
    """Messages before the first received one of each publisher."""

    _missing: dict[bytes, set[int]] = field(default_factory=dict)

    def note(self, gid: bytes, sequence: int) -> None:
        """Count the messages missing before `sequence`, or subtract one that arrives late."""
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


MAX_PACKERS = 128
"""Maximum number of packers per channel, one per message size. Each takes some 100 bytes."""

MAX_LATCHED = 64
"""Maximum number of publishers per topic whose last latched message is kept."""

Packer = tuple[Callable[..., None], bytes, int]
"""`pack_into` for one message size, the constant first bytes, and the length of the record."""


class LatchedMessage(NamedTuple):
    """The last message of a publisher. Times are in ns since the epoch."""

    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int


@dataclass(slots=True)
class ChannelState:
    """The live counts and latched messages of one channel. Only one thread changes each count."""

    topic: Topic
    received: int = 0
    """Changed by the loop: messages passed to `Recorder.write`, counted before anything else."""

    size: int = 0
    """Changed by the loop: bytes of received data."""

    newest_ns: int = 0
    """Changed by the loop: log time of the last message."""

    not_kept: int = 0
    """Changed by the loop: latched messages missing in later files for lack of memory."""

    dropped_by_loop: int = 0
    """Changed by the loop: dropped for lack of room, or after the end of the recorder."""

    throttled: int = 0
    """Changed by the loop: throttled messages, which do not count as received."""

    gaps: SequenceGaps = field(default_factory=SequenceGaps)
    expected: dict[bytes, int] = field(init=False)
    """`gaps.expected`, for the hot path."""

    packers: dict[int, Packer] = field(default_factory=dict)
    """Packers by message size."""

    latched: dict[bytes, LatchedMessage] | None = field(init=False)
    """Changed by the loop: the last message by publisher, None for a topic that is not latched."""

    written: int = 0
    """Changed by the writer thread: written with a valid footer."""

    not_repeated: int = 0
    """Changed by the writer thread: latched messages without room in a later file."""

    dropped_by_writer: int = 0
    """Changed by the writer thread: taken from the queue, but not written."""

    def __post_init__(self) -> None:
        """Set `expected`, and `latched` if the topic is latched."""
        self.expected = self.gaps.expected
        self.latched = {} if self.topic.latched else None

    def keep_latched(
        self, gid: bytes, data: Buffer, log_ns: int, publish_ns: int, sequence: int, room: int
    ) -> int:
        """Keep `data` as the last message of `gid`, and return the change in memory use [bytes].

        If the change exceeds `room`, no message of `gid` is kept. Beyond MAX_LATCHED publishers,
        the oldest message is discarded. Both are counted in `not_kept`.
        """
        if self.latched is None:
            return 0
        before = self.latched.pop(gid, None)
        freed = len(before.data) if before else 0
        try:
            own = bytes(data) if len(data) <= room + freed else None  # no copy if it is bytes
        except MemoryError:
            own = None
        if own is None:
            self.not_kept += 1
            return -freed
        if len(self.latched) >= MAX_LATCHED:
            self.not_kept += 1
            freed += len(self.latched.pop(next(iter(self.latched))).data)
        log_ns = min(max(log_ns, 0), MAX_TIME_NS)
        publish_ns = min(max(publish_ns, 0), MAX_TIME_NS)
        self.latched[gid] = LatchedMessage(own, log_ns, publish_ns, sequence & MAX_SEQUENCE)
        return len(own) - freed

    def latched_messages(self) -> list[LatchedMessage]:
        """Return a copy of the latched messages, for any thread."""
        return list(self.latched.values()) if self.latched else []

    @property
    def arrived(self) -> int:
        """Messages received or throttled."""
        return self.received + self.throttled

    @property
    def settled(self) -> bool:
        """Whether no message of the channel is queued or being packed."""
        received = self.received  # read first, or a message that is being packed could be missed
        return received == self.written + self.dropped_by_writer + self.dropped_by_loop

    def stats(self) -> TopicStats:
        """Return a consistent copy of the counts. Any thread may call it."""
        written, dropped = self.written, self.dropped_by_loop + self.dropped_by_writer
        received = self.received  # read last, so that queued is never negative
        queued, not_repeated = received - written - dropped, self.not_kept + self.not_repeated
        gaps, topic = self.gaps, self.topic
        return TopicStats(
            received,
            written,
            queued,
            dropped,
            gaps.lost,
            gaps.unseen,
            not_repeated,
            self.throttled,
            topic.name,
            topic.type_name,
            self.size,
        )
