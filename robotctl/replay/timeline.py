"""The messages of a recording, with times relative to the beginning of the replay."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from robotctl.errors import UsageError
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Message, Recording, RecordingInfo
from robotctl.replay.job import Job

Entry = tuple[int, str, bytes]
"""Recorded time since the replay's beginning [ns], recorded topic, message."""

MIN_PASS_NS: Final = 100_000_000
"""Minimum duration of a pass, for a loop over a single message."""


@dataclass(frozen=True, slots=True)
class Span:
    """The part of a recording that is played, in wall-clock ns, both ends included."""

    start_ns: int
    end_ns: int

    @property
    def length_ns(self) -> int:
        """Duration from beginning to end."""
        return self.end_ns - self.start_ns

    @property
    def pass_ns(self) -> int:
        """Duration of one pass of a loop."""
        return max(self.length_ns, MIN_PASS_NS)


def span_of(info: RecordingInfo, job: Job) -> Span:
    """Return the part that a job plays.

    Raises:
        UsageError: The part is empty.
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
    """Return the entries of a recording, of each topic those of its type.

    `latched` is the number of latched messages by topic.
    """

    def typed(messages: Iterable[Message]) -> Iterable[Message]:
        return (each for each in messages if topics[each.topic] == each.type_name)

    def before() -> Iterable[Message]:
        return typed(recording.last_before(span.start_ns, latched, on_missing))

    def during() -> Iterable[Message]:
        window = (span.start_ns, span.end_ns)
        return typed(recording.messages(topics.keys(), on_missing, window))

    return entries(before, during, span, loop=loop)


def entries(
    before: Callable[[], Iterable[Message]],
    during: Callable[[], Iterable[Message]],
    span: Span,
    *,
    loop: bool = False,
) -> Iterator[Entry]:
    """Yield what to send, in order; `before` and `during` are called for each pass.

    `before` returns what was latched when the span begins. It is sent first, because a late
    subscriber would have received it too. `during` returns the messages of the span by log time. A
    loop over nothing ends.
    """
    begin_ns = 0
    while True:
        is_empty = True
        for message in before():
            is_empty = False
            yield begin_ns, message.topic, message.data
        for message in during():
            is_empty = False
            yield begin_ns + message.log_ns - span.start_ns, message.topic, message.data
        if is_empty or not loop:
            return
        begin_ns += span.pass_ns
