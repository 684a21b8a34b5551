"""The messages of a recording on a line of time that begins where the replay does."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from robotctl.errors import UsageError
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Message, Recording, RecordingInfo
from robotctl.replay.job import Job

Entry = tuple[int, str, bytes]
"""When, in ns of recorded time since the replay's beginning; the recorded topic; the message."""

MIN_PASS_NS: Final = 100_000_000
"""A loop over a single message, which takes no time, still leaves some."""


@dataclass(frozen=True, slots=True)
class Span:
    """The part of a recording that is played, in wall-clock ns, both ends included."""

    start_ns: int
    end_ns: int

    @property
    def length_ns(self) -> int:
        """From the beginning to the end."""
        return self.end_ns - self.start_ns

    @property
    def pass_ns(self) -> int:
        """What one pass of a loop takes."""
        return max(self.length_ns, MIN_PASS_NS)


def span_of(info: RecordingInfo, job: Job) -> Span:
    """The part that a job plays. Raises UsageError where that is none."""
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
    topics: Collection[str],
    latched: Mapping[str, int],
    on_missing: Callable[[str], None],
    *,
    loop: bool,
) -> Iterator[Entry]:
    """The entries of a recording, with so many latched messages of each topic in `latched`."""

    def before() -> Iterable[Message]:
        return recording.last_before(span.start_ns, latched, on_missing)

    def during() -> Iterable[Message]:
        return recording.messages(topics, on_missing, (span.start_ns, span.end_ns))

    return entries(before, during, span, loop=loop)


def entries(
    before: Callable[[], Iterable[Message]],
    during: Callable[[], Iterable[Message]],
    span: Span,
    *,
    loop: bool = False,
) -> Iterator[Entry]:
    """What to send, in order; `before` and `during` are called for each pass.

    `before` gives what was latched when the span begins, and that comes first: a subscriber that
    came late would have had it, too. `during` gives the span's own messages by log time. A loop
    over nothing ends.
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
