"""What the recorder keeps and counts of each channel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from robotctl.recording.disk.storage import Buffer
from robotctl.recording.format.records import MAX_SEQUENCE, MAX_TIME_NS
from robotctl.recording.format.topics import Topic, TopicStats
from robotctl.recording.write.sequence_gaps import SequenceGaps

MAX_PACKERS = 128
"""Message sizes of a topic for which a packer is kept; each takes some hundred bytes."""

MAX_LATCHED = 64
"""Publishers of a topic whose last latched message is kept."""

Packer = tuple[Callable[..., None], bytes, int]
"""`pack_into` of one message size, the constant first bytes, and the length of the record."""


class LatchedMessage(NamedTuple):
    """The last message of a publisher; times in nanoseconds since the epoch."""

    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int


@dataclass(slots=True)
class ChannelState:
    """The running counts of one topic. Each count is changed by one thread only."""

    topic: Topic
    received: int = 0
    """By the loop, before anything else happens to the message."""

    size: int = 0
    """By the loop: bytes of received data."""

    newest_ns: int = 0
    """By the loop: log time of the last message."""

    not_kept: int = 0
    """By the loop: latched messages that later files do not repeat, for there was no memory."""

    dropped_by_loop: int = 0
    """By the loop: dropped, for there was no room, or the recorder has ended."""

    gaps: SequenceGaps = field(default_factory=SequenceGaps)
    expected: dict[bytes, int] = field(init=False)
    """The gaps's own map, one attribute nearer to the hot path."""

    packers: dict[int, Packer] = field(default_factory=dict)
    """How the recorder packs messages of a size."""

    latched: dict[bytes, LatchedMessage] | None = field(init=False)
    """The last message of each publisher, by the loop; None where the topic is not latched."""

    written: int = 0
    """By the writer thread: in the file, below a valid footer."""

    not_repeated: int = 0
    """By the writer thread: latched messages that a later file had no room for."""

    dropped_by_writer: int = 0
    """By the writer thread: dropped from the queue, for the file has failed."""

    def __post_init__(self) -> None:
        """Reach through to the gaps, and see whether the topic is latched."""
        self.expected = self.gaps.expected
        self.latched = {} if self.topic.latched else None

    def keep_latched(
        self, gid: bytes, data: Buffer, log_ns: int, publish_ns: int, sequence: int, room: int
    ) -> int:
        """Remember the last message of publisher `gid` where `room` bytes are enough for it.

        Returns by how many bytes the memory that is taken has grown. What has no room is counted
        in `not_kept`; the older message is not kept in its place, for it holds no more.
        """
        if self.latched is None:
            return 0
        before = self.latched.pop(gid, None)
        freed = len(before.data) if before else 0
        try:
            own = bytes(data) if len(data) <= room + freed else None  # of bytes this is no copy
        except MemoryError:
            own = None
        if own is None:
            self.not_kept += 1
            return -freed
        if len(self.latched) >= MAX_LATCHED:
            freed += len(self.latched.pop(next(iter(self.latched))).data)
        log_ns = min(max(log_ns, 0), MAX_TIME_NS)
        publish_ns = min(max(publish_ns, 0), MAX_TIME_NS)
        self.latched[gid] = LatchedMessage(own, log_ns, publish_ns, sequence & MAX_SEQUENCE)
        return len(own) - freed

    def latched_messages(self) -> list[LatchedMessage]:
        """A copy, for the writer thread."""
        return list(self.latched.values()) if self.latched else []

    @property
    def settled(self) -> bool:
        """No message of the topic is queued or being packed."""
        received = self.received  # read first: then a message in the making cannot be overlooked
        return received == self.written + self.dropped_by_writer + self.dropped_by_loop

    def stats(self) -> TopicStats:
        """A copy in which the counts agree."""
        written, dropped = self.written, self.dropped_by_loop + self.dropped_by_writer
        received = self.received  # read last: the others never overtake it
        return TopicStats(
            name=self.topic.name,
            type_name=self.topic.type_name,
            received=received,
            written=written,
            queued=received - written - dropped,
            dropped=dropped,
            lost=self.gaps.lost,
            unseen=self.gaps.unseen,
            bytes=self.size,
            not_repeated=self.not_kept + self.not_repeated,
        )
