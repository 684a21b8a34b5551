"""Detects topics that stop, slow down or speed up, and restarts of publishers.

If P is the expected period (the mean gap between messages), a topic is
- silent, after max(1 s, 3 P) without a message,
- slow, with fewer than half of the expected messages in a window of max(0.8 s, 3.5 P),
- fast, with 1.7 times the expected messages in a window, unless they only make up for late ones.

A topic is regular if one minute has at least FEWEST messages, no gap is much longer than the mean
gap, and (at a high rate) each SPAN_S has about the same number of messages.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from itertools import islice
from math import inf
from typing import Final, Protocol, assert_never

from robotctl.kernel.constants import NS_PER_S, TWIST, TWIST_STAMPED
from robotctl.recording.write.recorder_options import RateByTopic

LOOK_S: Final = 0.2
"""The time between two calls of `TopicHealth.look`."""

SILENT_S: Final = 1.0
SILENT_PERIODS: Final = 3.0
WINDOW_S: Final = 0.8
WINDOW_PERIODS: Final = 3.5
SLOW, SLOW_END = 0.5, 0.6
"""Shares of the messages expected in a window: SLOW begins below the first, ends at the second."""
FAST, FAST_END = 1.7, 1.5
"""Shares of the messages expected in a window: FAST begins at the first, ends below the second."""
FAST_BOTH: Final = 1.35
"""FAST also needs this share of the messages expected in the last two windows together."""


class Trouble(Enum):
    """The problem with the rate of a topic."""

    NONE = "as expected"
    SILENT = "silent"
    SLOW = "slow"
    FAST = "fast"


class TopicWatch:
    """Watches one topic that has an expected period, in seconds on a steady clock."""

    def __init__(self, period_s: float, now_s: float, count: int) -> None:
        """Watch from `now_s` on, after `count` messages."""
        self.period_s = period_s
        self.trouble = Trouble.NONE
        self.newest_s = now_s
        """When the newest message arrived."""

        self.restarted_s: float | None = None
        """When a publisher last replaced an earlier one, None if never."""

        self._patience_s = max(SILENT_S, SILENT_PERIODS * period_s) - LOOK_S
        """Silence [s] after which `look` reports SILENT, as the next `look` would be too late."""

        self._window_s = max(WINDOW_S, WINDOW_PERIODS * period_s)
        self._expected = self._window_s / period_s
        """The number of messages that are expected in a window."""

        self._count = count
        self._begin(now_s)
        self._publishers = 0
        self._replaced: tuple[float, dict[bytes, int]] | None = None
        """When a new publisher appeared, and the next sequence numbers of the older ones then."""

    @property
    def rate_hz(self) -> float:
        """The mean rate in the last window [Hz]."""
        return (self._count - self._window[0][1]) / self._window_s

    def look(self, now_s: float, count: int, newest_s: float) -> None:
        """Update `trouble`: `count` messages have arrived so far, the newest at `newest_s`."""
        if count != self._count:
            if newest_s - self.newest_s >= self._patience_s:
                self._begin(newest_s)  # a window that contains the silence would look slow
            self._count = count
            if newest_s > self.newest_s:
                self.newest_s = newest_s
            self._window.append((now_s, count))
        self.trouble = self._judge(now_s)

    def look_at_publishers(self, now_s: float, next_numbers: Mapping[bytes, int]) -> None:
        """Detect a restart by each publisher's next sequence number, the oldest publisher first."""
        if len(next_numbers) != self._publishers:
            if self._publishers:
                self._replaced = now_s, dict(islice(next_numbers.items(), self._publishers))
            self._publishers = len(next_numbers)
        if self._replaced is not None:
            since_s, others = self._replaced
            if any(next_numbers.get(gid, number) != number for gid, number in others.items()):
                self._replaced = None  # the new publisher is an additional one
            elif now_s - since_s >= self._patience_s:
                self.restarted_s, self._replaced = since_s, None

    def pause(self, now_s: float) -> None:
        """Discard the measured windows, after a time in which `look` was not called."""
        if self.trouble is not Trouble.SILENT:
            self.newest_s = now_s
        self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        self._begun_s = now_s
        # Pairs (time, count): first the last pair before the window, then those within it.
        self._window: deque[tuple[float, int]] = deque([(now_s, self._count)])
        self._before: deque[tuple[float, int]] = deque()
        """Pairs (time, count) as in `_window`, for the window before the present one."""

    def _judge(self, now_s: float) -> Trouble:
        if now_s - self.newest_s >= self._patience_s:
            return Trouble.SILENT
        window, before, window_s = self._window, self._before, self._window_s
        while len(window) > 1 and now_s - window[1][0] >= window_s:
            before.append(window.popleft())
        watched_s = now_s - self._begun_s
        if watched_s < window_s:
            return Trouble.NONE
        share = (self._count - window[0][1]) / self._expected
        if share < (SLOW_END if self.trouble is Trouble.SLOW else SLOW):
            return Trouble.SLOW
        while len(before) > 1 and now_s - before[1][0] >= 2.0 * window_s:
            before.popleft()
        least = FAST_END if self.trouble is Trouble.FAST else FAST
        if share >= least and watched_s >= 2.0 * window_s:
            first = before[0] if before else window[0]
            if self._count - first[1] >= 2.0 * FAST_BOTH * self._expected:
                return Trouble.FAST
        return Trouble.NONE


MINUTE_S: Final = 60.0
FEWEST: Final = 20
"""The fewest messages a minute of a regular topic."""

ROUNDS: Final = 3
"""Number of irregular minutes after which the period of a topic is not learned."""

LONGEST_GAP: Final = 1.6
"""The longest gap of a regular topic is at most this many mean gaps, plus GAP_SLACK_S."""

GAP_SLACK_S: Final = 0.25
"""Tolerance for measured gaps, which LOOK_S makes inexact."""

SPAN_S: Final = 0.8
FEWEST_IN_SPAN, MOST_IN_SPAN = 0.7, 1.4
"""Limits on the messages in each SPAN_S of a regular topic, as shares of the mean number."""


class LearnedPeriod:
    """Learns the mean gap between messages of one topic, in seconds on a steady clock."""

    def __init__(self, count: int) -> None:
        """Begin to learn with the next message, after `count` messages."""
        self.rounds_left = ROUNDS
        """How many more irregular minutes there may be."""

        self._restart(count)

    def _restart(self, count: int) -> None:
        self._before = count
        self._first: tuple[float, int] | None = None
        self._last_s = 0.0
        self._longest_s = 0.0
        self._recent: deque[tuple[float, int]] = deque()
        self._fewest, self._most = inf, 0.0

    def look(self, now_s: float, count: int, newest_s: float, *, late: bool) -> float | None:
        """Add the present message count; return the mean gap [s], None until it is learned."""
        if self._first is None:
            if count != self._before:
                self._first, self._last_s = (newest_s, count), newest_s
            return None
        if late:
            self._recent.clear()
        else:
            self._longest_s = max(self._longest_s, now_s - self._last_s - GAP_SLACK_S)
            self._count_span(now_s, count)
        self._last_s = newest_s
        begun_s, begun_count = self._first
        if now_s - begun_s < MINUTE_S:
            return None
        period_s = self._period(newest_s - begun_s, count - begun_count)
        self.rounds_left -= 1
        self._restart(count)
        return period_s

    def _count_span(self, now_s: float, count: int) -> None:
        recent = self._recent
        recent.append((now_s, count))
        while len(recent) > 1 and now_s - recent[1][0] >= SPAN_S:
            recent.popleft()
        span_s = now_s - recent[0][0]
        if span_s >= SPAN_S:
            in_span = (count - recent[0][1]) / span_s
            self._fewest, self._most = min(self._fewest, in_span), max(self._most, in_span)

    def _period(self, elapsed_s: float, messages: int) -> float | None:
        if messages < FEWEST:
            return None
        period_s = elapsed_s / messages
        is_fast = 3.0 * period_s <= SPAN_S
        is_even = (
            self._fewest * period_s >= FEWEST_IN_SPAN and self._most * period_s <= MOST_IN_SPAN
        )
        is_regular = self._longest_s <= LONGEST_GAP * period_s and (is_even or not is_fast)
        return period_s if is_regular else None


_log = logging.getLogger(__name__)

LATE_S: Final = 2.0 * LOOK_S
"""Time since the last `look` above which windows and gaps are not judged."""

RECENT_S: Final = 60.0
"""How long `status` still shows a trouble that is over."""

FORGET_S: Final = 600.0
"""Silence after which a learned topic is no longer watched."""

MAX_NAMED: Final = 20
MAX_TROUBLES: Final = 5
MAX_LOGGED: Final = 1_000
"""Limit on the logged sentences."""

_STAMP_SLACK_S: Final = 0.1
"""Limit on a new message's age at the last `look`, as `Tap` batches for up to 0.05 s."""

EVENTS: Final = frozenset(
    (
        TWIST,
        TWIST_STAMPED,
        "sensor_msgs/msg/Joy",
        "rcl_interfaces/msg/ParameterEvent",
    )
)
"""Types of topics that may be regular for minutes and then stop without any fault."""


def may_be_learned(topic: str, type_name: str) -> bool:
    """Return whether to learn a topic's rate: not for actions, service events, types in EVENTS."""
    is_call = "/_action/" in topic or topic.endswith("/_service_event")
    return not (is_call or type_name in EVENTS)


class Arrivals(Protocol):
    """Counts the messages that have arrived on a channel, recorded or not."""

    @property
    def arrived(self) -> int:
        """The number of messages."""

    @property
    def newest_ns(self) -> int:
        """The log time of the newest message."""

    @property
    def expected(self) -> Mapping[bytes, int]:
        """The next sequence number of each publisher by its gid, in order of first appearance."""


@dataclass(slots=True)
class _Topic:
    name: str
    learning: LearnedPeriod | None
    is_configured: bool = False
    watch: TopicWatch | None = None
    channels: list[Arrivals] = field(default_factory=list)
    count: int = 0
    newest_s: float = 0.0
    since_s: float = 0.0
    """When the present trouble began [s]."""

    over: tuple[Trouble, float, float] | None = None
    """The last trouble that has ended, its duration [s] and the time of its end [s]."""


class TopicHealth:
    """Watches the rates of topics, in the loop's thread only.

    Times are in seconds on a steady clock; `wall_ns` is since the epoch.
    """

    def __init__(self, expected: RateByTopic, names: Iterable[str], now_s: float) -> None:
        """`expected` has the configured rates. Topics in `names` are watched before they exist."""
        self._expected = expected
        self._topics: dict[str, _Topic] = {}
        self._active: dict[str, _Topic] = {}
        self._told: dict[str, _Topic] = {}
        """Topics by name whose trouble has changed."""

        self._looked_s = now_s
        self._logged = 0
        for name in names:
            self._topic(name, "", learns=False, now_s=now_s)

    def add(
        self,
        name: str,
        type_name: str,
        channel: Arrivals,
        *,
        learns: bool,
        now_s: float,
    ) -> None:
        """Watch a channel's message rate. With `learns`, learn it if none is configured."""
        self._topic(name, type_name, learns=learns, now_s=now_s).channels.append(channel)

    def _topic(self, name: str, type_name: str, *, learns: bool, now_s: float) -> _Topic:
        known = self._topics.get(name)
        if known is not None:
            return known
        topic = self._topics[name] = _Topic(name, None, newest_s=now_s)
        rate_hz = self._expected.of(name, type_name)
        if rate_hz:
            topic.watch = TopicWatch(1.0 / rate_hz, now_s, 0)
            topic.is_configured = True
        elif rate_hz is None and learns:
            topic.learning = LearnedPeriod(0)
        if topic.watch or topic.learning:
            self._active[name] = topic
        return topic

    def look(self, now_s: float, wall_ns: int) -> bool:
        """Judge each topic; return whether a trouble has changed or a publisher was restarted."""
        elapsed_s, self._looked_s = now_s - self._looked_s, now_s
        late, news = elapsed_s > LATE_S, False
        for topic in list(self._active.values()):
            count = 0
            for channel in topic.channels:
                count += channel.arrived
            if count != topic.count:
                newest_ns = max([each.newest_ns for each in topic.channels])
                age_s = (wall_ns - newest_ns) / NS_PER_S
                topic.newest_s = now_s - min(max(age_s, 0.0), elapsed_s + _STAMP_SLACK_S)
                topic.count = count
            if topic.watch is not None:
                news |= self._look_at(topic, topic.watch, now_s, late=late)
            elif topic.learning is not None:
                self._learn(topic, topic.learning, now_s, late=late)
        return news

    def warnings(self, now_s: float) -> Iterator[str]:
        """Yield a sentence for each trouble that is present or ended at most RECENT_S ago."""
        told: list[str] = []
        for topic in list(self._told.values()):
            sentences = list(_sentences(topic, now_s))
            told += sentences
            if not sentences:  # until its trouble changes again
                del self._told[topic.name]
        yield from islice(told, MAX_NAMED)
        if len(told) > MAX_NAMED:
            yield f"{len(told) - MAX_NAMED} more topics have other rates than expected"

    def troubles(self) -> str:
        """Return a text that names topics in trouble or still without a message, "" for none."""
        found = [
            f"{topic.name} is {topic.watch.trouble.value}"
            if topic.count
            else f"{topic.name} has no message yet"
            for topic in self._active.values()
            if topic.watch and (topic.watch.trouble is not Trouble.NONE or not topic.count)
        ]
        more = f" and {len(found) - MAX_TROUBLES} more" if len(found) > MAX_TROUBLES else ""
        return ", ".join(found[:MAX_TROUBLES]) + more

    def _look_at(self, topic: _Topic, watch: TopicWatch, now_s: float, *, late: bool) -> bool:
        if late:
            watch.pause(now_s)
        before, restarted_s = watch.trouble, watch.restarted_s
        watch.look(now_s, topic.count, topic.newest_s)
        if len(topic.channels) == 1:
            watch.look_at_publishers(now_s, topic.channels[0].expected)
        if not topic.is_configured and now_s - watch.newest_s >= FORGET_S:
            topic.watch, topic.learning = None, LearnedPeriod(topic.count)
            return True
        if watch.restarted_s != restarted_s:
            self._tell(f"the publisher of {topic.name} was restarted")
        elif watch.trouble is before:
            return False
        self._told[topic.name] = topic
        if watch.trouble is not before:
            if before is not Trouble.NONE:
                topic.over = before, now_s - topic.since_s, now_s
            topic.since_s = watch.newest_s if watch.trouble is Trouble.SILENT else now_s
            self._tell(_trouble(topic, watch, now_s) or f"{topic.name} is as expected again")
        return True

    def _learn(self, topic: _Topic, learning: LearnedPeriod, now_s: float, *, late: bool) -> None:
        period_s = learning.look(now_s, topic.count, topic.newest_s, late=late)
        if period_s is not None:
            topic.watch, topic.learning = TopicWatch(period_s, now_s, topic.count), None
            _log.debug("%s has %.3g messages a second", topic.name, 1.0 / period_s)
        elif not learning.rounds_left:
            del self._active[topic.name]

    def _tell(self, sentence: str) -> None:
        self._logged += 1
        if self._logged <= MAX_LOGGED:
            _log.warning("%s", sentence)


def _sentences(topic: _Topic, now_s: float) -> Iterator[str]:
    watch = topic.watch
    if watch is None:
        return
    if trouble := _trouble(topic, watch, now_s):
        yield trouble
    elif topic.over is not None and now_s - topic.over[2] <= RECENT_S:
        what, lasted_s, ended_s = topic.over
        yield f"{topic.name} was {what.value} for {lasted_s:.1f} s, {now_s - ended_s:.0f} s ago"
    if watch.restarted_s is not None and now_s - watch.restarted_s <= RECENT_S:
        yield f"the publisher of {topic.name} was restarted {now_s - watch.restarted_s:.0f} s ago"


def _trouble(topic: _Topic, watch: TopicWatch, now_s: float) -> str:
    expected_hz = 1.0 / watch.period_s
    match watch.trouble:
        case Trouble.NONE:
            return ""
        case Trouble.SILENT:
            silent_s = now_s - watch.newest_s
            has = "has been silent for" if topic.count else "has had no message for"
            expected = f"({expected_hz:.3g} messages a second are expected)"
            return f"{topic.name} {has} {silent_s:.1f} s {expected}"
        case Trouble.SLOW | Trouble.FAST:
            rate_hz = watch.rate_hz
            return f"{topic.name} has {rate_hz:.3g} messages a second instead of {expected_hz:.3g}"
        case _:
            assert_never(watch.trouble)
