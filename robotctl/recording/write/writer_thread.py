"""The writer thread: takes packed messages from the queue and writes them."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import partial
from queue import Empty, SimpleQueue

from robotctl.recording.disk.disk_errors import cure_of, reason_of
from robotctl.recording.disk.thread_priority import rank_below
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.write.bag_writer import BagWriter
from robotctl.recording.write.buffer import LargeMessage, PackBuffer, PackedMessages
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.chunk_encoder import OutOfMemory
from robotctl.recording.write.evidence_chunks import EvidenceChunks
from robotctl.recording.write.recorder_options import RecorderOptions

SPARE_BUFFERS = 2
"""Empty buffers kept for the loop: one to change to, one for a burst. Further ones are freed."""

NICE = 5
"""How far the thread's priority is below the loop's. When all cores are busy, the loop gets three
times the CPU time of the compression."""

_BREATH_S = 0.001
"""Pause before a retry of something that failed or was not ready."""

_SETTLE_S = 1.0
"""How long `stop` waits for a message that is being packed; packing takes a microsecond."""


class WriterCommand(Enum):
    """What the loop may request through the queue, besides writing."""

    SPLIT = "go on in a new file"
    STOP = "finish"


class WriterThread:
    """The thread that writes the files.

    The loop puts full buffers into `queue`. Every `flush_s` the thread also takes what is in the
    active buffer. The first error ends the file and is kept in `failure`; queued messages are
    counted as dropped from then on.
    """

    def __init__(
        self,
        writer: BagWriter,
        options: RecorderOptions,
        channels: Sequence[ChannelState],
        active: Callable[[], PackBuffer],
        on_failure: Callable[[str], None],
    ) -> None:
        """Start the thread; `active` returns the buffer that the loop is packing."""
        self.queue: SimpleQueue[PackBuffer | LargeMessage | RecordedEvent | WriterCommand] = (
            SimpleQueue()
        )
        self.spare: deque[PackBuffer] = deque()
        self.released = 0
        """Bytes of queued buffers and messages that are free again."""

        self.failure = ""
        self.no_memory = 0
        """Messages dropped because there was no memory to write them."""

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

    def stop(self) -> None:
        """Write everything queued, finish the file, end the thread."""
        self.queue.put(WriterCommand.STOP)
        self._thread.join()

    def _run(self) -> None:
        rank_below(NICE)
        self._survive(lambda: self._attempt(self._writer.begin_seal))
        while not self._stopping:
            self._survive(self._turn)
        deadline = time.monotonic() + _SETTLE_S
        while True:
            self._survive(self._empty_queue)
            if self._is_settled() or time.monotonic() > deadline:
                break
            time.sleep(_BREATH_S)
        self._survive(lambda: self._attempt(self._writer.close))

    def _survive(self, work: Callable[[], object]) -> None:
        """Call `work`; an exception ends the file but not the thread, so it can be reported."""
        try:
            work()
        except Exception as error:  # noqa: BLE001
            try:
                self._fail(error)
            except Exception:  # noqa: BLE001  # no memory to report it: the next turn retries
                time.sleep(_BREATH_S)

    def _turn(self) -> None:
        """Handle one queued item, and the periodic work that is due."""
        wait = max(min(self._next_flush, self._next_sync) - time.monotonic(), 0.0)
        with suppress(Empty):
            self._handle(self.queue.get(timeout=wait))
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

    def _is_settled(self) -> bool:
        return self.queue.empty() and all(state.settled for state in self._channels)

    def _empty_queue(self) -> None:
        while not self.queue.empty():
            self._handle(self.queue.get())
        self._flush_active()

    def _flush_active(self) -> None:
        buffer = self._active()
        if not self.queue.empty():
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

    def _handle(self, item: PackBuffer | LargeMessage | RecordedEvent | WriterCommand) -> None:
        if isinstance(item, WriterCommand):
            if item is WriterCommand.SPLIT:
                self._attempt(self._writer.split)
            else:
                self._stopping = True
            return
        if isinstance(item, RecordedEvent):
            event = item
            self._attempt(lambda: self._writer.write_event(event))
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
        if isinstance(item, PackBuffer) and len(self.spare) < SPARE_BUFFERS:
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
        """Count messages as dropped, by channel: for lack of memory, unless the file has failed."""
        for channel, count in counts.items():
            state = self._channels[channel]
            state.dropped_by_writer += count
            state.mark()
            if not self.failure:
                self.no_memory += count

    def _attempt(self, work: Callable[[], None]) -> bool:
        """Call `work` unless the file has failed, and return whether it succeeded.

        The first error is kept. A lack of memory that leaves the file unchanged is not an error.
        """
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
