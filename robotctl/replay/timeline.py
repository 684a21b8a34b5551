"""The messages of a recording, with times relative to the start of the replay."""

from __future__ import annotations

import threading
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Self

from robotctl.base.errors import UsageError
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording import Message, Recording, RecordingInfo
from robotctl.replay.job import Job

Entry = tuple[int, str, bytes]
"""(Recorded time since the start of the replay [ns], recorded topic, serialized message)."""

MIN_PASS_NS: Final = 100_000_000
"""Minimum duration of a pass, so that a loop over one message has pauses."""


@dataclass(frozen=True, slots=True)
class Span:
    """The part of a recording to play, as log times [ns since the epoch], both inclusive."""

    start_ns: int
    end_ns: int

    @property
    def length_ns(self) -> int:
        """Duration from start to end."""
        return self.end_ns - self.start_ns

    @property
    def pass_ns(self) -> int:
        """Duration of one pass of a loop, `length_ns` or MIN_PASS_NS if that is more."""
        return max(self.length_ns, MIN_PASS_NS)


def span_of(info: RecordingInfo, job: Job) -> Span:
    """Return the first and last log time that `job` plays.

    Raises:
        UsageError: The part starts after the end of the recording.
    """
    if job.start_offset_s > info.duration_s:
        raise UsageError(
            f"--start-offset {job.start_offset_s:g}: "
            f"the recording ends after {info.duration_s:.1f} s"
        )
    start_ns = info.start_ns + round(job.start_offset_s * NS_PER_S)
    end_ns = info.end_ns
    if job.duration_s is not None:
        end_ns = min(end_ns, start_ns + round(job.duration_s * NS_PER_S))
    return Span(start_ns, end_ns)


def recorded(
    recording: Recording,
    span: Span,
    topics: Mapping[str, str],
    latched: Mapping[str, int],
    on_missing: Callable[[str], None],
    *,
    loop: bool,
) -> Iterator[Entry]:
    """Return the latched messages from before `span`, then all messages within `span`.

    `topics` has the type of each topic to play. `latched` has, for each latched topic, the largest
    number of messages from before the span.
    """

    def typed(messages: Iterable[Message]) -> Iterable[Message]:
        return (each for each in messages if topics[each.topic] == each.type_name)

    def before() -> Iterable[Message]:
        return typed(recording.last_before(span.start_ns, latched, on_missing))

    def during() -> Iterable[Message]:
        return typed(recording.messages(topics.keys(), on_missing, (span.start_ns, span.end_ns)))

    return entries(before, during, span, loop=loop)


def entries(
    before: Callable[[], Iterable[Message]],
    during: Callable[[], Iterable[Message]],
    span: Span,
    *,
    loop: bool = False,
) -> Iterator[Entry]:
    """Yield the entries to send: in each pass, first those of `before()`, then of `during()`.

    `before` returns the messages latched at the start of the span, and `during` those of the span
    in the order of log time. With `loop`, passes repeat until one is empty.
    """
    begin_ns = 0
    while True:
        is_empty = True
        # A late subscriber would have received them too.
        for message in before():
            is_empty = False
            yield begin_ns, message.topic, message.data
        for message in during():
            is_empty = False
            yield begin_ns + message.log_ns - span.start_ns, message.topic, message.data
        if is_empty or not loop:
            return
        begin_ns += span.pass_ns


BATCH_ENTRIES: Final = 256
BATCH_BYTES: Final = 1 << 20
AHEAD_ENTRIES: Final = 16_384
"""The default limit on the messages that wait to be sent."""

AHEAD_BYTES: Final = 64 << 20
"""Maximum size of all messages that wait to be sent. One batch may be larger."""


class ReadAhead:
    """Iterates over `entries` in batches, which a thread reads in advance within the `with` block.

    The thread is about `ahead` entries in advance. Any thread may call `close` and `count`.
    """

    def __init__(self, entries: Iterable[Entry], ahead: int = AHEAD_ENTRIES) -> None:
        self._entries = entries
        self._ahead = ahead
        self._batch_entries = min(BATCH_ENTRIES, ahead)
        self._given: list[Entry] = []
        self._changed = threading.Condition()
        self._batches: deque[tuple[list[Entry], int]] = deque()
        self._waiting_entries = 0
        self._waiting_bytes = 0
        self._ended = False
        self._closed = False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="read-ahead", daemon=True)

    def __enter__(self) -> Self:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop reading, and wait until the thread has ended."""
        self.close()
        self._thread.join()

    def close(self) -> None:
        """End the iteration at the next batch."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __iter__(self) -> Iterator[list[Entry]]:
        """Yield each batch when it is read. Afterwards raise an exception of the thread, if any."""
        while True:
            with self._changed:
                while not (self._batches or self._ended or self._closed):
                    self._changed.wait()
                if self._closed:
                    return
                if not self._batches:
                    break
                batch, size = self._batches.popleft()
                self._waiting_entries -= len(batch)
                self._waiting_bytes -= size
                self._given = batch
                self._changed.notify_all()
            yield batch
        if self._failure is not None:
            raise self._failure

    def count(self, after_ns: int, until_ns: int) -> int:
        """Count the messages in memory with `after_ns` < replay time <= `until_ns`."""
        with self._changed:
            batches = [self._given, *(batch for batch, _ in self._batches)]
        return sum(
            bisect_right(batch, until_ns, key=_at_ns) - bisect_right(batch, after_ns, key=_at_ns)
            for batch in batches
        )

    def _run(self) -> None:
        try:
            self._read()
        except BaseException as failure:  # noqa: BLE001 - raised again by the iteration
            self._failure = failure
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _read(self) -> None:
        batch: list[Entry] = []
        size = 0
        try:
            for entry in self._entries:
                batch.append(entry)
                size += len(entry[2])
                if len(batch) >= self._batch_entries or size >= BATCH_BYTES:
                    full, full_size, batch, size = batch, size, [], 0
                    if not self._put(full, full_size):
                        return
        finally:
            if batch:
                self._put(batch, size)

    def _put(self, batch: list[Entry], size: int) -> bool:
        """Wait for room and add the batch. Return False after `close`."""
        with self._changed:
            while not self._closed and self._batches and self._is_full(len(batch), size):
                self._changed.wait()
            if self._closed:
                return False
            self._batches.append((batch, size))
            self._waiting_entries += len(batch)
            self._waiting_bytes += size
            self._changed.notify_all()
            return True

    def _is_full(self, entries: int, size: int) -> bool:
        return (
            self._waiting_entries + entries > self._ahead
            or self._waiting_bytes + size > AHEAD_BYTES
        )


def _at_ns(entry: Entry) -> int:
    return entry[0]
