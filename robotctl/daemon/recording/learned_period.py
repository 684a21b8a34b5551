"""Learns how often a topic has a message, if it has them regularly.

A topic is regular if a whole minute has at least FEWEST messages, no gap is much longer than their
mean, and, where messages come fast, each SPAN_S has about as many. So what is sent once, at events,
in bunches or at random is not learned.
"""

from __future__ import annotations

from collections import deque
from math import inf
from typing import Final

MINUTE_S: Final = 60.0
FEWEST: Final = 20
"""A random topic with fewer messages might look regular."""

ROUNDS: Final = 3
"""A topic that is irregular for this many minutes is not learned any more."""

LONGEST_GAP: Final = 1.6
"""In mean gaps..."""

GAP_SLACK_S: Final = 0.25
"""...plus this: two looks cannot tell a shorter one."""

SPAN_S: Final = 0.8
FEWEST_IN_SPAN, MOST_IN_SPAN = 0.7, 1.4
"""Messages in each SPAN_S, as a share of their mean number."""


class LearnedPeriod:
    """The mean gap between the messages of one topic; times in seconds on a steady clock."""

    def __init__(self, count: int) -> None:
        """Begin with the first message after the first `count`."""
        self._rounds_left = ROUNDS
        self._restart(count)

    @property
    def has_given_up(self) -> bool:
        """Whether the topic was irregular for too long."""
        return not self._rounds_left

    def _restart(self, count: int) -> None:
        self._before = count
        self._first: tuple[float, int] | None = None
        self._last_s = 0.0
        self._longest_s = 0.0
        self._recent: deque[tuple[float, int]] = deque()
        self._fewest, self._most = inf, 0.0

    def look(self, now_s: float, count: int, newest_s: float, *, late: bool) -> float | None:
        """Note the number of messages so far and when the newest came; return a learned period.

        `late` tells that the looks had a gap, so that messages may wait that are not counted yet.
        """
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
        self._rounds_left -= 1
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
        if self._longest_s > LONGEST_GAP * period_s:
            return None
        fast = SPAN_S / period_s >= 3.0
        if fast and not (
            self._fewest * period_s >= FEWEST_IN_SPAN and self._most * period_s <= MOST_IN_SPAN
        ):
            return None
        return period_s
