"""Pause, rate and single steps of a running replay, for any thread."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Final, Self

from robotctl.replay.job import MAX_RATE, MIN_RATE

_STEPS: Final = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
"""The rates for keys, for each power of ten."""

RATES: Final = tuple(
    round(step * 10.0**power, 4)
    for power in range(-3, 5)
    for step in _STEPS
    if MIN_RATE <= round(step * 10.0**power, 4) <= MAX_RATE
)


@dataclass(frozen=True, slots=True)
class Schedule:
    """Maps recorded time to steady time, with `at_ns` (recorded) due at `moment_ns` (steady).

    From `moment_ns` on, `rate` recorded seconds are due each second, or all at once if `rate` is
    None. While `paused`, nothing is due.
    """

    moment_ns: int
    at_ns: int
    rate: float | None
    paused: bool = False

    def due_ns(self, at_ns: int) -> int:
        """Return the steady time at which recorded time `at_ns` is due."""
        if self.rate is None:
            return self.moment_ns
        return self.moment_ns + round((at_ns - self.at_ns) / self.rate)

    def position_ns(self, now_ns: int) -> int:
        """Return the recorded time that is due at steady time `now_ns`."""
        if self.paused or self.rate is None:
            return self.at_ns
        return self.at_ns + max(round((now_ns - self.moment_ns) * self.rate), 0)

    def changed(self, now_ns: int, **changes: Any) -> Self:
        """Return a schedule with `changes` that continues from the position at `now_ns`."""
        return replace(self, moment_ns=now_ns, at_ns=self.position_ns(now_ns), **changes)


def faster(rate: float) -> float:
    """Return the next higher rate in RATES, or `rate` if none is higher."""
    return min((each for each in RATES if each > rate), default=rate)


def slower(rate: float) -> float:
    """Return the next lower rate in RATES, or `rate` if none is lower."""
    return max((each for each in RATES if each < rate), default=rate)


class PlaybackControl:
    """Stores the current schedule, and changes it. `now_ns` returns the steady time."""

    def __init__(
        self, rate: float | None, now_ns: Callable[[], int], *, paused: bool = False
    ) -> None:
        self._now_ns = now_ns
        self._changing = threading.Lock()
        self._schedule = Schedule(now_ns(), 0, rate, paused)
        self._steps = 0

    @property
    def schedule(self) -> Schedule:
        """The current schedule. A change replaces the object."""
        return self._schedule

    def begin(self, moment_ns: int) -> None:
        """Make recorded time 0 due at steady time `moment_ns`, or at `resume` if paused."""
        with self._changing:
            self._schedule = replace(self._schedule, moment_ns=moment_ns, at_ns=0)

    def pause(self) -> None:
        """Stop recorded time until `resume`."""
        with self._changing:
            self._schedule = self._schedule.changed(self._now_ns(), paused=True)

    def resume(self) -> None:
        """Continue from the current position."""
        with self._changing:
            if self._schedule.paused:
                self._steps = 0
                self._schedule = self._schedule.changed(self._now_ns(), paused=False)

    def toggle(self) -> None:
        """Pause or resume."""
        (self.resume if self._schedule.paused else self.pause)()

    def faster(self) -> None:
        """Play at the next higher rate. At rate `max`, do nothing."""
        self._change_rate(faster)

    def slower(self) -> None:
        """Play at the next lower rate. At rate `max`, do nothing."""
        self._change_rate(slower)

    def step(self) -> None:
        """Allow one more message during this pause. Outside a pause, do nothing."""
        with self._changing:
            self._steps += self._schedule.paused

    def takes_step(self, at_ns: int) -> bool:
        """Use up a `step` for the message at recorded time `at_ns`. Return False without a step."""
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
                self._schedule = self._schedule.changed(self._now_ns(), rate=change(rate))


class Command(Enum):
    """A change of playback, sent to the replay process by a key press or Ctrl-Z."""

    PAUSE = "pause"
    RESUME = "resume"
    TOGGLE = "toggle"
    FASTER = "faster"
    SLOWER = "slower"
    NEXT = "next"

    def line(self) -> bytes:
        """Return the line for the replay process."""
        return f"{json.dumps({'do': self.value})}\n".encode()


def command_of(line: bytes) -> Command | None:
    """Return the command in a line, or None if the line has no valid command."""
    try:
        return Command(json.loads(line)["do"])
    except (ValueError, TypeError, KeyError):
        return None


def carry_out(command: Command, control: PlaybackControl) -> None:
    """Apply a command to `control`."""
    actions: dict[Command, Callable[[], None]] = {
        Command.PAUSE: control.pause,
        Command.RESUME: control.resume,
        Command.TOGGLE: control.toggle,
        Command.FASTER: control.faster,
        Command.SLOWER: control.slower,
        Command.NEXT: control.step,
    }
    actions[command]()
