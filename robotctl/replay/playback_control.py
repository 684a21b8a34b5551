"""The schedule of a replay under way, and whoever changes it; usable from any thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

from robotctl.replay.schedule import Schedule, faster, slower


class PlaybackControl:
    """Pause, rate and single steps. `now_ns` is the steady clock."""

    def __init__(
        self, rate: float | None, now_ns: Callable[[], int], *, paused: bool = False
    ) -> None:
        self._now_ns = now_ns
        self._changing = threading.Lock()
        self._schedule = Schedule(now_ns(), 0, rate, paused)
        self._steps = 0

    @property
    def schedule(self) -> Schedule:
        """What is due when, as it is now; a change makes another object."""
        return self._schedule

    def begin(self, moment_ns: int) -> None:
        """Let recorded time begin at a moment, or at the end of a pause that is on."""
        with self._changing:
            self._schedule = replace(self._schedule, moment_ns=moment_ns)

    def pause(self) -> None:
        """Stand still, until `resume`."""
        with self._changing:
            self._schedule = self._schedule.pause(self._now_ns())

    def resume(self) -> None:
        """Go on from where it stands."""
        with self._changing:
            if self._schedule.paused:
                self._steps = 0
                self._schedule = self._schedule.resume(self._now_ns())

    def toggle(self) -> None:
        """Pause, or go on."""
        (self.resume if self._schedule.paused else self.pause)()

    def faster(self) -> None:
        """Play at the next higher rate; as fast as possible stays so."""
        self._change_rate(faster)

    def slower(self) -> None:
        """Play at the next lower rate; as fast as possible stays so."""
        self._change_rate(slower)

    def step(self) -> None:
        """While paused: let the next message go, and stand still behind it."""
        with self._changing:
            self._steps += self._schedule.paused

    def takes_step(self, at_ns: int) -> bool:
        """Whether the next message, of this recorded moment, is let go although it is paused."""
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
