"""Pause, rate and single steps of a running replay; usable from any thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

from robotctl.replay.schedule import Schedule, faster, slower


class PlaybackControl:
    """Holds the current schedule, and changes it. `now_ns` returns the steady time."""

    def __init__(
        self, rate: float | None, now_ns: Callable[[], int], *, paused: bool = False
    ) -> None:
        self._now_ns = now_ns
        self._changing = threading.Lock()
        self._schedule = Schedule(now_ns(), 0, rate, paused)
        self._steps = 0

    @property
    def schedule(self) -> Schedule:
        """The current schedule; a change replaces the object."""
        return self._schedule

    def begin(self, moment_ns: int) -> None:
        """Start playback at `moment_ns` of the steady clock, or at the end of a current pause.

        Recorded time that has passed until now does not count: nothing was played.
        """
        with self._changing:
            self._schedule = replace(self._schedule, moment_ns=moment_ns, at_ns=0)

    def pause(self) -> None:
        """Stop recorded time until `resume`."""
        with self._changing:
            self._schedule = self._schedule.pause(self._now_ns())

    def resume(self) -> None:
        """Continue from the current position."""
        with self._changing:
            if self._schedule.paused:
                self._steps = 0
                self._schedule = self._schedule.resume(self._now_ns())

    def toggle(self) -> None:
        """Pause or resume."""
        (self.resume if self._schedule.paused else self.pause)()

    def faster(self) -> None:
        """Play at the next higher rate; without effect at `max`."""
        self._change_rate(faster)

    def slower(self) -> None:
        """Play at the next lower rate; without effect at `max`."""
        self._change_rate(slower)

    def step(self) -> None:
        """During a pause, allow one more message."""
        with self._changing:
            self._steps += self._schedule.paused

    def takes_step(self, at_ns: int) -> bool:
        """Return whether the next message, at `at_ns`, may be sent during a pause."""
        with self._changing:
            if not (self._steps and self._schedule.paused):
                return False
            self._steps -= 1
            self._schedule = replace(self._schedule, at_ns=at_ns)
            return True

    def _change_rate(self, change: Callable[[float], float]) -> None:
        with self._changing:
            rate = self._schedule.rate
            if rate is not None:
                self._schedule = self._schedule.with_rate(self._now_ns(), change(rate))
