"""Sends messages when they are due, in one thread, by absolute times on the steady clock."""

from __future__ import annotations

import ctypes
import errno
import os
import time
from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final, Protocol

from robotctl.kernel.constants import NS_PER_S
from robotctl.replay.playback_control import PlaybackControl
from robotctl.replay.timeline import Entry

SPIN_NS: Final = 40_000
"""The last part of a wait, in which the clock is polled, because a thread may wake late."""

_PR_SET_TIMERSLACK: Final = 29
_NO_SLACK_NS: Final = 1
"""The timer slack to set. By default Linux may wake a thread 50 us late to group timers."""

_TIMER_ABSTIME: Final = 1


class Clock(Protocol):
    """A monotonic clock in nanoseconds."""

    def now_ns(self) -> int:
        """Return the current time."""

    def sleep_until(self, moment_ns: int) -> None:
        """Return at `moment_ns`, or at once if it has passed."""


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class SteadyClock:
    """CLOCK_MONOTONIC, for use by one thread."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=False)  # releases the GIL while it sleeps
        self._sleep = libc.clock_nanosleep
        self._sleep.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
        self._prctl = libc.prctl
        self._has_slack = True
        self._until = _Timespec()
        self._pointer = ctypes.addressof(self._until)

    def now_ns(self) -> int:
        """Return the time of the steady clock [ns]."""
        return time.monotonic_ns()

    def sleep_until(self, moment_ns: int) -> None:
        """Return at `moment_ns`, within a few microseconds.

        Raises:
            OSError: The system call fails.
        """
        if self._has_slack:
            self._has_slack = False
            self._prctl(_PR_SET_TIMERSLACK, _NO_SLACK_NS, 0, 0, 0)  # of the calling thread
        until = self._until
        until.seconds, until.nanoseconds = divmod(max(moment_ns - SPIN_NS, 0), NS_PER_S)
        failure = errno.EINTR
        while failure == errno.EINTR:
            failure = self._sleep(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, self._pointer, None)
        if failure:
            raise OSError(failure, os.strerror(failure))
        while time.monotonic_ns() < moment_ns:
            pass


_SUB_BITS: Final = 5
"""2**5 = 32 bins per power of two, so that a quantile is at most 3 % too high."""

_LARGEST: Final = (1 << 62) - 1


class Lateness:
    """A histogram of delays [ns], with wider bins for larger values."""

    __slots__ = ("_counts", "count", "max_ns")

    def __init__(self) -> None:
        self._counts = array("Q", bytes(8 * (_step(_LARGEST) + 1)))
        self.count = 0
        self.max_ns = 0

    def add(self, late_ns: int) -> None:
        """Add one delay [ns]. A negative delay counts as 0."""
        late_ns = min(max(late_ns, 0), _LARGEST)
        self._counts[_step(late_ns)] += 1
        self.count += 1
        if late_ns > self.max_ns:
            self.max_ns = late_ns

    def quantile_us(self, share: float) -> float:
        """Return the quantile [us] of all delays at `share` (0 to 1), 0 if there are no delays."""
        rank = share * self.count
        seen = 0
        for step, count in enumerate(self._counts):
            seen += count
            if count and seen >= rank:
                return min(_highest(step), self.max_ns) / 1e3
        return 0.0


def _step(value: int) -> int:
    shift = max(value.bit_length() - _SUB_BITS - 1, 0)
    return (shift << _SUB_BITS) + (value >> shift)


def _highest(step: int) -> int:
    """Return the largest value in the bin with this number."""
    shift = max((step >> _SUB_BITS) - 1, 0)
    return ((step - (shift << _SUB_BITS) + 1) << shift) - 1


Send = Callable[[bytes], bool | None]
"""Sends a serialized message. Returns whether it was accepted, None if nothing was to be sent."""

LEAD_NS: Final = 5_000_000
"""Time from the start of playback to the first message, so that it is on time too."""

SLICE_NS: Final = 50_000_000
"""Maximum delay until a stop or a changed schedule takes effect."""


@dataclass(slots=True)
class TopicSender:
    """The sender of a topic's messages, with the numbers of sent and failed messages."""

    send: Send
    sent: int = 0
    failed: int = 0


class ClockPublisher:
    """Calls `send` with the recorded position every `period_ns` of real time, also while paused."""

    def __init__(self, period_ns: int, send: Callable[[int], object]) -> None:
        self.period_ns = period_ns
        self.send = send
        self.due_ns = 0

    def tick(self, now_ns: int, position_ns: int) -> None:
        """Send `position_ns` if a tick is due at `now_ns`. Missed ticks are skipped."""
        if now_ns >= self.due_ns:
            self.send(position_ns)
            following_ns = self.due_ns + self.period_ns
            self.due_ns = following_ns if following_ns > now_ns else now_ns + self.period_ns


class Player:
    """Sends each recorded message on its topic when it is due, or at once if `rate` is None.

    `run` sends in the thread that calls it. Any thread may use all other members.
    """

    def __init__(
        self,
        batches: Iterable[Sequence[Entry]],
        sends: dict[str, Send],
        *,
        rate: float | None,
        clock: Clock,
        paused: bool = False,
        delay_ns: int = 0,
        ticks: ClockPublisher | None = None,
    ) -> None:
        self.topics = {topic: TopicSender(send) for topic, send in sends.items()}
        self.control = PlaybackControl(rate, clock.now_ns, paused=paused)
        self.lateness = Lateness()
        self.position_ns = 0
        """Time in the replay of the last sent message [ns]."""

        self.late_ns = 0
        """The delay of the last message with a due time [ns]."""

        self._batches = batches
        self._clock = clock
        self._ticks = ticks
        self._delay_ns = delay_ns
        self._stopped = False

    @property
    def sent(self) -> int:
        """The number of messages that the middleware accepted, over all topics."""
        return sum(topic.sent for topic in self.topics.values())

    def stop(self) -> None:
        """Stop sending."""
        self._stopped = True

    def run(self) -> None:
        """Send until the entries end or `stop` is called."""
        batches = iter(self._batches)
        first = next(batches, ())
        self.control.begin(self._clock.now_ns() + LEAD_NS + self._delay_ns)
        for batch in chain((first,), batches):
            for at_ns, topic, data in batch:
                due_ns = self._wait_for(at_ns)
                if self._stopped:
                    return
                self._send(self.topics[topic], data, due_ns)
                self.position_ns = at_ns

    def _wait_for(self, at_ns: int) -> int | None:
        """Wait for the message's due time and return it. None at rate `max`, a step or a stop."""
        clock, control = self._clock, self.control
        while not self._stopped:
            schedule = control.schedule
            now_ns = clock.now_ns()
            wake_ns = now_ns + SLICE_NS
            if self._ticks is not None:
                is_free = schedule.rate is None
                position_ns = self.position_ns if is_free else schedule.position_ns(now_ns)
                self._ticks.tick(now_ns, position_ns)
                wake_ns = min(wake_ns, self._ticks.due_ns)
            if schedule.paused:
                if control.takes_step(at_ns):
                    return None
                clock.sleep_until(wake_ns)
                continue
            due_ns = schedule.due_ns(at_ns)
            if due_ns > wake_ns:
                clock.sleep_until(wake_ns)
                continue
            if schedule.rate is not None or due_ns > now_ns:
                clock.sleep_until(due_ns)
            if control.schedule is schedule:
                return due_ns if schedule.rate is not None else None
        return None

    def _send(self, topic: TopicSender, data: bytes, due_ns: int | None) -> None:
        if due_ns is not None:
            self.late_ns = self._clock.now_ns() - due_ns
            self.lateness.add(self.late_ns)
        taken = topic.send(data)
        if taken:
            topic.sent += 1
        elif taken is False:
            topic.failed += 1
