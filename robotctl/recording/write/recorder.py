"""The recorder of messages from the event loop in always-valid MCAP files."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import inf
from pathlib import Path
from typing import Final

from mcap.opcode import Opcode

from robotctl.base.errors import Refused
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording.format.disk import Buffer
from robotctl.recording.format.recorded_events import RecordedEvent
from robotctl.recording.format.records import (
    MAX_SEQUENCE,
    MAX_TIME_NS,
    MESSAGE_FIELDS_BYTES,
    MESSAGE_HEAD,
)
from robotctl.recording.format.topics import MessageCounts, Topic, TopicStats, total
from robotctl.recording.write.bag_writer import begin_bag
from robotctl.recording.write.buffer import LargeMessage, PackBuffer
from robotctl.recording.write.channel_state import MAX_PACKERS, ChannelState, Packer
from robotctl.recording.write.recorder_options import RecorderOptions
from robotctl.recording.write.writer_thread import WriterCommand, WriterThread


class RecorderState(StrEnum):
    """Whether messages are recorded (RECORDING) or only counted as dropped (FAILED, CLOSED)."""

    RECORDING = "recording"
    FAILED = "failed"
    CLOSED = "closed"


@dataclass(slots=True, kw_only=True)
class RecorderStats(MessageCounts):
    """The recorder at one instant. The counts are the sums over `topics`.

    `bytes` is the size of all files of the recording. `no_memory` counts messages dropped because
    the process could not allocate memory. `failure` and `warning` are sentences, or "".
    """

    state: RecorderState
    file: Path
    bytes: int
    no_memory: int
    failure: str
    warning: str
    topics: tuple[TopicStats, ...]


MAX_TOPICS: Final = 1 << 16
"""Maximum number of topics: a channel id of MCAP has 16 bits."""

_PREFIX = struct.Struct("<BQH")
"""Opcode, record length and channel id, the first bytes of a message."""


class Recorder:
    """A recorder that writes one folder in rosbag2's layout.

    Any thread may call `add_event` and `close`, only the event loop's thread the other methods.
    """

    def __init__(
        self,
        folder: Path,
        options: RecorderOptions | None = None,
        *,
        metadata: Callable[[], Mapping[str, str]] = dict,
        on_failure: Callable[[str], None],
        on_split: Callable[[Path], None] = lambda path: None,
        on_full: Callable[[Path], None] | None = None,
    ) -> None:
        """Create `folder` with its first file, and start the writer thread.

        `metadata` returns the values to store in each new file. `on_failure` gets a sentence for
        the operator, at most once. `on_split` gets the path of each later file. `on_full` gets the
        path of each full file and must cause a call of `split`; without it, the next file begins.
        All are called in the writer thread, except `metadata` for the first file.

        Raises:
            Refused: The folder cannot be written.
        """
        options = options or RecorderOptions()
        self._channels: list[ChannelState] = []
        self._channel_of: dict[Topic, int] = {}
        self._closed = False
        self._chunk_bytes = options.chunk_bytes
        self._memory_bytes = options.memory_bytes
        self._latched_bytes = 0
        self._no_memory = 0
        self._buffer = PackBuffer(options.chunk_bytes)
        self._acquired = self._buffer.size
        self._writer = begin_bag(folder, options, metadata, self._channels, on_split, on_full)
        self._thread = WriterThread(
            self._writer, options, self._channels, lambda: self._buffer, on_failure
        )

    def add_topic(self, topic: Topic) -> int:
        """Return the channel id of `topic`, which is added if it is new.

        Raises:
            Refused: There are MAX_TOPICS topics already.
        """
        known = self._channel_of.get(topic)
        if known is not None:
            return known
        channel = len(self._channels)
        if channel >= MAX_TOPICS:
            raise Refused(f"a recording holds at most {MAX_TOPICS} topics: exclude some")
        self._buffer.make_indexes(channel + 1)
        self._channels.append(ChannelState(topic))
        self._channel_of[topic] = channel
        return channel

    def write(
        self, channel: int, data: Buffer, log_ns: int, publish_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Record a message, or count it as dropped. Never waits. The caller may reuse `data`.

        Times are since the epoch. `sequence` is the publisher's number of the message, or 0.
        """
        state = self._channels[channel]
        state.received += 1
        try:
            size = len(data)
            state.size += size
            expected = state.expected
            if expected.get(gid) == sequence:
                expected[gid] = sequence + 1
            else:
                state.gaps.note(gid, sequence)
            if state.latched is not None:
                room = self._memory_bytes // 3 - self._latched_bytes
                self._latched_bytes += state.keep_latched(
                    gid, data, log_ns, publish_ns, sequence, room
                )
            buffer = self._buffer
            if log_ns < state.newest_ns:
                buffer.unordered.add(channel)
            state.newest_ns = log_ns
            start = buffer.end
            try:
                pack, prefix, length = state.packers[size]
                end = start + length
                if end <= buffer.limit:
                    pack(buffer.data, start, prefix, sequence, log_ns, publish_ns, data)
                    index = buffer.indexes[channel]
                    index.append(log_ns)
                    index.append(start)
                    buffer.end = end
                    return
            except (KeyError, struct.error):
                pass  # a new message size, or a number that does not fit into its field
            self._write_carefully(channel, data, log_ns, publish_ns, sequence)
        except MemoryError:
            self._drop_for_memory(state, channel)

    def leave_out(self, channel: int, log_ns: int, sequence: int, gid: bytes) -> None:
        """Count a message as throttled instead of recording it."""
        state = self._channels[channel]
        state.throttled += 1
        state.newest_ns = log_ns
        state.gaps.note(gid, sequence)

    def channel(self, channel: int) -> ChannelState:
        """Return the live counts of a channel. Read them in the loop's thread only."""
        return self._channels[channel]

    def split(self) -> None:
        """Begin a new file for later messages. Returns at once. No effect after `close`."""
        if self._closed:
            return
        if self._buffer.end and self._has_memory(self._chunk_bytes):
            self._change_buffer()
        self._thread.put(WriterCommand.SPLIT)

    def add_event(self, event: RecordedEvent) -> None:
        """Store `event` in the metadata of the current file. Never waits."""
        self._thread.put(event)

    def stats(self) -> RecorderStats:
        """Return the current counts. Call it in the loop's thread, or after `close`."""
        topics = tuple([state.stats() for state in self._channels])
        return RecorderStats(
            state=self._state(),
            file=self._writer.path,
            bytes=self._writer.size,
            **total(topics),
            no_memory=self._no_memory + self._thread.no_memory,
            failure=self._thread.failure,
            warning=self._writer.warning,
            topics=topics,
        )

    def close(self) -> RecorderStats:
        """Finish the recording, and return the final counts. A second call is harmless.

        Blocks until all queued messages are written. Later messages count as dropped.
        """
        self._closed = True
        self._thread.stop()
        return self.stats()

    def _state(self) -> RecorderState:
        if self._thread.failure:
            return RecorderState.FAILED
        return RecorderState.CLOSED if self._closed else RecorderState.RECORDING

    def _write_carefully(
        self, channel: int, data: Buffer, log_ns: int, publish_ns: int, sequence: int
    ) -> None:
        """Record a message that `write` could not pack, or count it as dropped."""
        state = self._channels[channel]
        if self._closed or self._thread.failure:
            state.dropped_by_loop += 1
            return
        sequence &= MAX_SEQUENCE
        log_ns = min(max(log_ns, 0), MAX_TIME_NS)
        publish_ns = min(max(publish_ns, 0), MAX_TIME_NS)
        length = MESSAGE_HEAD.size + len(data)
        if length > self._chunk_bytes // 2:
            if not self._has_memory(len(data) + self._chunk_bytes):
                state.dropped_by_loop += 1
                return
            self._queue_large(LargeMessage((channel, bytes(data), log_ns, publish_ns, sequence)))
            return
        buffer = self._buffer_with_room(length)
        if buffer is None:
            state.dropped_by_loop += 1
            return
        start = buffer.end
        data = bytes(data)  # a view cannot be packed
        pack, prefix, _ = state.packers.get(len(data)) or _new_packer(state, channel, len(data))
        pack(buffer.data, start, prefix, sequence, log_ns, publish_ns, data)
        index = buffer.indexes[channel]
        index.append(log_ns)
        index.append(start)
        buffer.end = start + length

    def _drop_for_memory(self, state: ChannelState, channel: int) -> None:
        """Count a message dropped for lack of memory, and remove its incomplete index entry."""
        index = self._buffer.indexes[channel]
        if len(index) % 2:
            index.pop()
        state.dropped_by_loop += 1
        self._no_memory += 1

    def _buffer_with_room(self, length: int) -> PackBuffer | None:
        """Return an active buffer with room for `length` bytes, None if the budget is used up."""
        buffer = self._buffer
        if buffer.end + length <= buffer.limit:
            return buffer
        if self._has_memory(self._chunk_bytes):
            self._change_buffer()
            return self._buffer
        return buffer if buffer.end + length <= buffer.size else None

    def _queue_large(self, message: LargeMessage) -> None:
        if self._buffer.end:
            self._change_buffer()  # keep the order
        self._acquired += message.size
        self._thread.put(message)

    def _has_memory(self, size: int) -> bool:
        waiting = self._acquired - self._thread.released + self._latched_bytes
        return waiting + size <= self._memory_bytes

    def _change_buffer(self) -> None:
        """Pass the active buffer to the writer thread, and continue in an empty one."""
        spare = self._thread.spare
        buffer = spare.popleft() if spare else PackBuffer(self._chunk_bytes)
        buffer.make_indexes(len(self._channels))
        self._acquired += buffer.size + self._buffer.weigh()
        self._thread.put(self._buffer)
        self._buffer = buffer


def _new_packer(state: ChannelState, channel: int, size: int) -> Packer:
    """Return the packer for messages of `size` bytes."""
    prefix = _PREFIX.pack(Opcode.MESSAGE, MESSAGE_FIELDS_BYTES + size, channel)
    layout = struct.Struct(f"<{_PREFIX.size}sIQQ{size}s")
    packer = layout.pack_into, prefix, layout.size
    if len(state.packers) < MAX_PACKERS:
        state.packers[size] = packer
    return packer


class MessageGate:
    """A callback that records one message per 1 / `most_hz`, and counts others as throttled."""

    def __init__(self, recorder: Recorder, channel: int, most_hz: float = inf) -> None:
        """Record at most `most_hz` messages per second, all for inf, none for 0."""
        self._recorder = recorder
        self._channel = channel
        self._interval_ns = round(NS_PER_S / most_hz) if most_hz else None
        self._due_ns = 0
        self.is_shut = False
        """Whether all messages are counted as throttled."""

    def __call__(
        self, data: Buffer, log_ns: int, publish_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Record a message, or count it as throttled. The arguments are those of Recorder.write."""
        if self.is_shut or not self._keeps(log_ns):
            self._recorder.leave_out(self._channel, log_ns, sequence, gid)
        else:
            self._recorder.write(self._channel, data, log_ns, publish_ns, sequence, gid)

    def _keeps(self, log_ns: int) -> bool:
        interval_ns, due_ns = self._interval_ns, self._due_ns
        if not interval_ns:
            return interval_ns == 0
        if due_ns - interval_ns <= log_ns < due_ns:  # before that, the clock was set back
            return False
        is_on_time = due_ns <= log_ns < due_ns + interval_ns
        self._due_ns = (due_ns if is_on_time else log_ns) + interval_ns
        return True
