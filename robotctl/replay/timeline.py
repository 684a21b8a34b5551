"""The messages of a recording on a line of time that begins where the replay does."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from robotctl.recording.reader import Message

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


def entries(
    read: Callable[[], Iterable[Message]],
    span: Span,
    latched: Mapping[str, int],
    *,
    loop: bool = False,
) -> Iterator[Entry]:
    """What to send, in order; `read` is called for each pass and yields by log time.

    Of the topics in `latched` the last messages before the span, as many as the mapping says,
    come first of all: a subscriber that came late would have had them, too.
    """
    begin_ns = 0
    while True:
        yield from _one_pass(read(), span, latched, begin_ns)
        if not loop:
            return
        begin_ns += max(span.length_ns, MIN_PASS_NS)


def _one_pass(
    messages: Iterable[Message], span: Span, latched: Mapping[str, int], begin_ns: int
) -> Iterator[Entry]:
    before = {topic: deque[bytes](maxlen=depth) for topic, depth in latched.items()}
    start_ns, end_ns = span.start_ns, span.end_ns
    started = False
    for message in messages:
        log_ns = message.log_ns
        if log_ns < start_ns:
            if message.topic in before:
                before[message.topic].append(message.data)
            continue
        if log_ns > end_ns:
            break
        if not started:
            started = True
            yield from _held(before, begin_ns)
        yield begin_ns + log_ns - start_ns, message.topic, message.data
    if not started:
        yield from _held(before, begin_ns)


def _held(before: Mapping[str, Iterable[bytes]], at_ns: int) -> Iterator[Entry]:
    for topic, messages in before.items():
        for data in messages:
            yield at_ns, topic, data
