"""The writer thread, which writes the packed messages of the event loop."""

from __future__ import annotations

import ctypes
import os
import platform
import struct
import threading
import time
from array import array
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final

from robotctl.recording.format.disk import cure_of, reason_of
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.format.records import MESSAGE_FIELDS_BYTES, MESSAGE_HEAD, RECORD_HEAD_BYTES
from robotctl.recording.write.bag_writer import BagWriter
from robotctl.recording.write.buffer import LargeMessage, OutOfMemory, PackBuffer, PackedMessages
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.recorder_options import RecorderOptions

SLICE_NS: Final = 20_000_000
"""Time slice of the thread. Since Linux 6.12, waking threads preempt longer slices at once."""

_SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274}
"""Number of the system call `sched_setattr`. glibc before 2.41 has no function for it."""


_SCHED_ATTR: Final = struct.Struct("=IIQiIQQQ")
"""Size, policy, flags, nice, priority, runtime, deadline and period: see sched_setattr(2)."""


def rank_below(nice: int) -> None:
    """Make all other threads preempt the calling thread, and add `nice` to its niceness."""
    os.nice(nice)
    with suppress(OSError):  # a container may forbid it
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None:
        return
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = _SCHED_ATTR.pack(_SCHED_ATTR.size, os.SCHED_BATCH, 0, nice, 0, SLICE_NS, 0, 0)
    ctypes.CDLL(None).syscall(number, 0, attributes, 0)  # a kernel may not know it


HEAVY_BYTES: Final = 64 << 10
"""Minimum data of other topics for a second chunk [bytes]."""

HEAVY_RATIO: Final = 4
"""Minimum ratio of other topics' data to evidence data for a second chunk."""

assert MESSAGE_HEAD.size == RECORD_HEAD_BYTES + MESSAGE_FIELDS_BYTES


class EvidenceChunks:
    """Separates evidence topics, which a check of decisions reads, from topics with more data."""

    # A chunk is read as a whole: otherwise a check of the decisions would read every image.

    def __init__(self, topics: Collection[str], channels: Sequence[ChannelState]) -> None:
        """`topics` are the full names of the evidence topics. `channels` may grow."""
        self._topics = frozenset(topics)
        self._channels = channels
        self._known = 0
        self._evidence: set[int] = set()

    def separate(self, packed: PackedMessages) -> tuple[PackedMessages, ...]:
        """Return two chunks, evidence and the rest, or only `packed` if a split saves too little.

        Raises:
            MemoryError: There is no memory for the copies; nothing is changed.
        """
        if not self._topics or len(packed.parts) != 1:  # several parts are one large message
            return (packed,)
        self._learn()
        chosen = [channel for channel in packed.indexes if channel in self._evidence]
        if not chosen or len(chosen) == len(packed.indexes):
            return (packed,)
        view = memoryview(packed.parts[0])
        spans = _spans(view, (packed.indexes[channel] for channel in chosen))
        evidence_bytes = sum(end - start for start, end in spans)
        rest_bytes = len(view) - evidence_bytes
        if rest_bytes < max(HEAVY_BYTES, HEAVY_RATIO * evidence_bytes):
            return (packed,)
        others = [channel for channel in packed.indexes if channel not in self._evidence]
        gaps = _between(spans, len(view))
        return _part(view, spans, packed, chosen), _part(view, gaps, packed, others)

    def _learn(self) -> None:
        """Find the channels of evidence topics among the new channels."""
        known = len(self._channels)
        for channel in range(self._known, known):
            if self._channels[channel].topic.name in self._topics:
                self._evidence.add(channel)
        self._known = known


_Span = tuple[int, int]
"""Start and end [bytes] of records."""


def _spans(view: memoryview, indexes: Iterable[array[int]]) -> list[_Span]:
    """Return the spans of the records in `indexes`, in order. Adjacent spans are joined."""
    length = slice(1, RECORD_HEAD_BYTES)
    spans: list[_Span] = []
    for start in sorted(offset for index in indexes for offset in index[1::2]):
        size = int.from_bytes(view[start + length.start : start + length.stop], "little")
        end = start + RECORD_HEAD_BYTES + size
        if spans and spans[-1][1] == start:
            spans[-1] = spans[-1][0], end
        else:
            spans.append((start, end))
    return spans


def _between(spans: Sequence[_Span], size: int) -> list[_Span]:
    """Return the spans from 0 to `size` outside of `spans`."""
    edges = [0, *(edge for span in spans for edge in span), size]
    return [(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if start < end]


def _part(
    view: memoryview, spans: Sequence[_Span], packed: PackedMessages, channels: Iterable[int]
) -> PackedMessages:
    """Return only the messages of `channels`, whose records are at `spans`."""
    starts = [start for start, _ in spans]
    shifts: list[int] = []
    size = 0
    for start, end in spans:
        shifts.append(start - size)
        size += end - start
    indexes: dict[int, array[int]] = {}
    for channel in channels:
        index = packed.indexes[channel][:]
        for place in range(1, len(index), 2):
            index[place] -= shifts[bisect_right(starts, index[place]) - 1]
        indexes[channel] = index
    times = [time_ns for index in indexes.values() for time_ns in index[::2]]
    content = b"".join(view[start:end] for start, end in spans)
    return PackedMessages([content], indexes, min(times), max(times))


SPARE_BUFFERS = 2
"""Maximum number of empty buffers kept for the loop."""

NICE = 5
"""Niceness added to the thread: on busy cores, the event loop gets three times its CPU time."""

_BREATH_S = 0.001
"""Pause before a retry [s]."""

_SETTLE_S = 1.0
"""Time limit at the end for the packing of a last message."""


class WriterCommand(Enum):
    """A command from the event loop to the writer thread, queued between buffers of messages."""

    SPLIT = "go on in a new file"
    STOP = "finish"


Queued = PackBuffer | LargeMessage | RecordedEvent | WriterCommand
"""The items in the queue of the writer thread."""


class WriterThread:
    """The thread that writes the files until a first error, described in `failure`."""

    def __init__(
        self,
        writer: BagWriter,
        options: RecorderOptions,
        channels: Sequence[ChannelState],
        active: Callable[[], PackBuffer],
        on_failure: Callable[[str], None],
    ) -> None:
        """Start the thread. `active` returns the loop's present buffer."""
        self._queue: SimpleQueue[Queued] = SimpleQueue()
        self._wake = threading.Lock()
        """Released for a queued item. `SimpleQueue.get` may never time out before Python 3.13."""

        self.spare: deque[PackBuffer] = deque(maxlen=SPARE_BUFFERS)
        self.released = 0
        """Total size of the queued buffers and messages freed so far [bytes]."""

        self.failure = ""
        self.no_memory = 0
        """Messages dropped for lack of memory to write them."""

        self._writer = writer
        self._options = options
        self._channels = channels
        self._active = active
        self._on_failure = on_failure
        self._evidence = EvidenceChunks(options.evidence, channels)
        self._stopping = False
        self._next_flush = time.monotonic() + options.flush_s
        self._next_sync = time.monotonic() + options.sync_s
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, item: Queued) -> None:
        """Queue an item without waiting."""
        self._queue.put(item)
        with suppress(RuntimeError):  # the thread is awake
            self._wake.release()

    def stop(self) -> None:
        """Write everything queued, finish the file, end the thread."""
        self.put(WriterCommand.STOP)
        self._thread.join()

    def _run(self) -> None:
        rank_below(NICE)
        self._survive(lambda: self._attempt(self._writer.begin_seal))
        while not self._stopping:
            self._survive(self._turn)
        deadline = time.monotonic() + _SETTLE_S
        while True:
            self._survive(self._empty_queue)
            settled = self._queue.empty() and all(state.settled for state in self._channels)
            if settled or time.monotonic() > deadline:
                break
            time.sleep(_BREATH_S)
        self._survive(lambda: self._attempt(self._writer.close))

    def _survive(self, work: Callable[[], object]) -> None:
        """Call `work`. An exception ends the file, not the thread, and is put into `failure`."""
        try:
            work()
        except Exception as error:  # noqa: BLE001
            try:
                self._fail(error)
            except Exception:  # noqa: BLE001  # no memory to report it: the next turn retries
                time.sleep(_BREATH_S)

    def _turn(self) -> None:
        """Handle one queued item, and the due periodic work."""
        if self._queue.empty():
            due = min(self._next_flush, self._next_sync)
            self._wake.acquire(timeout=max(due - time.monotonic(), 0.0))
        with suppress(Empty):
            self._handle(self._queue.get_nowait())
        now = time.monotonic()
        if now >= self._next_flush:
            self._next_flush = now + self._options.flush_s
            self._flush_active()
            self._attempt(self._writer.list_new_topics)
        if now >= self._next_sync:
            self._attempt(self._writer.sync)
            self._attempt(self._writer.check_space)
            self._attempt(self._writer.refresh_metadata)
            self._next_sync = time.monotonic() + self._options.sync_s

    def _empty_queue(self) -> None:
        while not self._queue.empty():
            self._handle(self._queue.get())
        self._flush_active()

    def _flush_active(self) -> None:
        buffer = self._active()
        if not self._queue.empty():
            return  # keep the order
        buffer.limit = 0
        try:
            packed = buffer.take()
        except MemoryError:
            if self._stopping:  # there is no next turn
                self._drop(buffer.drop())
            return
        if packed is None:
            self._attempt(self._writer.write_topics)
        else:
            self._write(packed)

    def _handle(self, item: Queued) -> None:
        if isinstance(item, WriterCommand):
            if item is WriterCommand.SPLIT:
                self._attempt(self._writer.split)
            else:
                self._stopping = True
            return
        if isinstance(item, RecordedEvent):
            self._attempt(partial(self._writer.write_event, item))
            return
        try:
            packed = item.take()
        except MemoryError:
            self._drop(item.drop())
            self.released += item.size
            return
        if packed is not None:
            self._write(packed)
            del packed
        self.released += item.size
        if isinstance(item, PackBuffer) and item is not self._active():  # the loop packs another
            item.recycle()
            self.spare.append(item)

    def _write(self, packed: PackedMessages) -> None:
        try:
            parts = self._evidence.separate(packed)
        except MemoryError:
            parts = (packed,)
        for part in parts:
            if not self._attempt(partial(self._writer.write, part)):
                self._drop({channel: len(index) // 2 for channel, index in part.indexes.items()})

    def _drop(self, counts: Mapping[int, int]) -> None:
        """Count dropped messages by channel, and in `no_memory` unless the file has failed."""
        for channel, count in counts.items():
            self._channels[channel].dropped_by_writer += count
            if not self.failure:
                self.no_memory += count

    def _attempt(self, work: Callable[[], None]) -> bool:
        """Call `work` unless the file has failed, and return whether it succeeded."""
        if self.failure:
            return False
        try:
            work()
        except OutOfMemory:
            return False
        except Exception as error:  # noqa: BLE001  # any error must be reported to the robot
            self._fail(error)
            return False
        return True

    def _fail(self, error: Exception) -> None:
        if self.failure:
            return
        text = f"recording stopped: {reason_of(error)} ({self._writer.path})"
        try:
            self._writer.abandon()
        except Exception as second:  # noqa: BLE001  # the disk may be gone
            text += f"; the end of the file could not be repaired: {reason_of(second)}"
        text += f"; {cure_of(error)}"
        self.failure = text
        self._active().limit = 0
        with suppress(Exception):  # a failing listener must not stop the counting
            self._on_failure(text)
