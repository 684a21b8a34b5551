"""Whether one topic still has as many messages as expected; pure, on a clock that is given.

With period P, the mean gap between messages that is expected, a topic is
- silent, after max(1 s, 3 P) without a message,
- slow, with fewer than half of the expected messages within max(0.8 s, 3.5 P), so that one lost
  message of a slow topic is no trouble,
- fast, with 1.7 times as many in that time, and not only because others were late.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from enum import Enum
from itertools import islice
from typing import Final

LOOK_S: Final = 0.2
"""The time between two looks."""

SILENT_S: Final = 1.0
SILENT_PERIODS: Final = 3.0
WINDOW_S: Final = 0.8
WINDOW_PERIODS: Final = 3.5
SLOW, SLOW_END = 0.5, 0.6
FAST, FAST_END = 1.7, 1.5
FAST_BOTH: Final = 1.35
"""Shares of the expected messages in one window; FAST_BOTH is for the last two."""


class Trouble(Enum):
    """What is wrong with the rate of a topic."""

    NONE = "as expected"
    SILENT = "silent"
    SLOW = "slow"
    FAST = "fast"


class TopicWatch:
    """The watch over one topic with an expected period; times in seconds on a steady clock."""

    def __init__(self, period_s: float, now_s: float, count: int) -> None:
        """Begin with `count` messages so far."""
        self.period_s = period_s
        self.trouble = Trouble.NONE
        self.newest_s = now_s
        """When the newest message came."""

        self.restarted_s: float | None = None
        """When a publisher took the place of an earlier one, None if none did."""

        self._patience_s = max(SILENT_S, SILENT_PERIODS * period_s) - LOOK_S
        """How long the topic may be silent, less the time to the next look."""

        self._window_s = max(WINDOW_S, WINDOW_PERIODS * period_s)
        self._expected = self._window_s / period_s
        """Messages in a window."""

        self._count = count
        self._begin(now_s)
        self._publishers = 0
        self._replaced: tuple[float, dict[bytes, int]] | None = None
        """When a new publisher came, and the numbers of the others then."""

    @property
    def rate_hz(self) -> float:
        """The messages a second within the last window."""
        return (self._count - self._window[0][1]) / self._window_s

    def look(self, now_s: float, count: int, newest_s: float) -> None:
        """Note the number of messages so far, and when the newest came."""
        if count != self._count:
            if newest_s - self.newest_s >= self._patience_s:
                self._begin(newest_s)  # a window with the silence in it tells nothing new
            self._count = count
            if newest_s > self.newest_s:
                self.newest_s = newest_s
            self._window.append((now_s, count))
        self.trouble = self._judge(now_s)

    def look_at_publishers(self, now_s: float, next_numbers: Mapping[bytes, int]) -> None:
        """Note the sequence number that each publisher sends next, the oldest publisher first.

        A new publisher replaces the others if none of them sends any more.
        """
        if len(next_numbers) != self._publishers:
            if self._publishers:
                self._replaced = now_s, dict(islice(next_numbers.items(), self._publishers))
            self._publishers = len(next_numbers)
        if self._replaced is not None:
            since_s, others = self._replaced
            if any(next_numbers.get(gid, number) != number for gid, number in others.items()):
                self._replaced = None  # it is one more
            elif now_s - since_s >= self._patience_s:
                self.restarted_s, self._replaced = since_s, None

    def pause(self, now_s: float) -> None:
        """Begin again: the looks had a gap, and messages may wait that are not counted yet."""
        if self.trouble is not Trouble.SILENT:
            self.newest_s = now_s
        self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        self._begun_s = now_s
        # Times and counts: first the last one before the window, then those within it.
        self._window: deque[tuple[float, int]] = deque([(now_s, self._count)])
        self._before: deque[tuple[float, int]] = deque()
        """The same for the window before."""

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
