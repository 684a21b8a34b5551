"""What each recorded robot status must show: mode, battery level, whether odometry was fresh.

The control loop publishes a status within the step that changes the mode, and one a second between
steps. So the times of the steps tell what each status must show.
"""

from __future__ import annotations

import struct
from collections import deque
from math import inf, isnan, nan
from typing import Final, NamedTuple

from robotctl.kernel.battery import is_level
from robotctl.kernel.modes import Mode
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.clock_changes import CLOCK_NS, EXCUSES_NS, ClockChanges
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.values_over_time import Timeline

AGE_NS: Final = NS_PER_S // 10
"""How near to its timeout the age of odometry may count as either fresh or stale."""

MAX_WAITING: Final = 10_000
"""The number of statuses that wait for the journal."""

_FLOAT = struct.Struct("<f")
_UNKNOWN = _FLOAT.pack(nan)


class RecordedStatus(NamedTuple):
    """A recorded status; `publish_ns` is since the epoch."""

    mode: int
    level: float
    is_connected: bool
    publish_ns: int


class StatusTimes:
    """The comparison of the statuses with the journal by time, from a snapshot on."""

    def __init__(self, clock: ClockChanges) -> None:
        self.wrong = 0
        self.example = ""
        self.unshown = 0
        """The number of changes of the mode without a status at that time that shows it."""

        self._clock = clock
        self._modes: Timeline[int] | None = None
        self._levels = Timeline(_UNKNOWN)
        self._statuses: deque[tuple[RecordedStatus, int, int]] = deque(maxlen=MAX_WAITING)
        """Each with its time by the steady clock, and that of the event before it in the file."""

        self._mode = Mode.IDLE.value
        self._level = _UNKNOWN
        self._t_ns = self._wall_ns = 0

        self._begin_ns = self._offset_ns = 0
        self._due_ns: float = inf
        self._without: deque[tuple[int, int]] = deque(maxlen=MAX_WAITING)
        """Each time without new odometry: when the last came [steady ns], and when the next was
        handled [ns since the epoch]."""

        self._odometry_ns = 0
        self._timeouts_ns: tuple[int, int] | None = None
        """The shortest and the longest timeout of odometry."""

    def snapshot(self, snapshot: Snapshot, t_ns: int, wall_ns: int) -> None:
        """Continue from a snapshot, with its time by the steady clock and since the epoch."""
        self._move_to(t_ns, wall_ns)
        state = snapshot.state
        timeout_ns = round(snapshot.params.odometry.timeout_s * NS_PER_S)
        shortest, longest = self._timeouts_ns or (timeout_ns, timeout_ns)
        self._timeouts_ns = min(shortest, timeout_ns), max(longest, timeout_ns)
        if self._modes is None:
            self._mode, self._level = state.mode.value, _packed(state.health.battery_level)
            self._begin(wall_ns)
            self._odometry_ns = state.health.odometry_t_ns
        self._settle(wall_ns - NS_PER_S)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._modes = None
        self._statuses.clear()
        self._without.clear()

    def _begin(self, wall_ns: int) -> None:
        """Forget what was compared; compare from `wall_ns` on, in ns since the epoch."""
        self._begin_ns = wall_ns
        self._modes, self._levels = Timeline(self._mode), Timeline(self._level)

    def _move_to(self, t_ns: int, wall_ns: int) -> None:
        """Take a moment by both clocks; begin again where the wall clock was set."""
        offset_ns, self._offset_ns = self._offset_ns, wall_ns - t_ns
        if self._modes is not None and abs(self._offset_ns - offset_ns) > CLOCK_NS:
            self._settle(self._wall_ns - EXCUSES_NS)
            self._statuses.clear()
            self._without.clear()
            self._begin(wall_ns)
        self._t_ns, self._wall_ns = t_ns, wall_ns

    def status(self, status: RecordedStatus) -> None:
        """Take a status."""
        if self._modes is not None and status.publish_ns >= self._begin_ns:
            steady_ns = status.publish_ns - self._offset_ns
            self._statuses.append((status, steady_ns, self._t_ns))

    def step(self, t_ns: int, log_ns: int, odometry_ns: int) -> None:
        """Take the time of an event by both clocks, and when new odometry last came."""
        self._move_to(t_ns, log_ns)
        if odometry_ns != self._odometry_ns:
            if odometry_ns - self._odometry_ns > AGE_NS:
                self._without.append((self._odometry_ns, log_ns))
            self._odometry_ns = odometry_ns

    def mode(self, mode: Mode, moments: Moments) -> None:
        """Take the mode after a step."""
        self._mode = mode.value
        if self._modes is not None:
            self._modes.change(self._mode, moments)

    def level(self, level: float | None, moments: Moments) -> None:
        """Take the battery level after a step."""
        self._level = _packed(level)
        self._levels.change(self._level, moments)

    def end(self, due_ns: float) -> None:
        """Judge what is left; changes need a status only before `due_ns` since the epoch."""
        self._due_ns = due_ns
        self._settle(inf)

    def _settle(self, until_ns: float) -> None:
        self._judge(until_ns)
        self._forget(until_ns)
        while self._without and self._without[0][1] < until_ns - NS_PER_S:
            self._without.popleft()

    def _judge(self, until_ns: float) -> None:
        while self._statuses and self._statuses[0][0].publish_ns < until_ns:
            status, steady_ns, seen_ns = self._statuses.popleft()
            self._forget(status.publish_ns)
            text = self._difference(status, steady_ns)
            if text and not any(map(self._clock.is_near, (steady_ns, seen_ns))):
                self.wrong += 1
                self.example = self.example or text

    def _forget(self, until_ns: float) -> None:
        for _ in self._levels.forget(until_ns):
            pass
        for change in () if self._modes is None else self._modes.forget(until_ns):
            steady_ns, begin_ns, _ = change.moments
            is_due = begin_ns < self._due_ns and not self._clock.is_near(steady_ns)
            self.unshown += is_due and not change.is_shown

    def _difference(self, status: RecordedStatus, steady_ns: int) -> str:
        """Return what is wrong about a status, "" if nothing is."""
        modes = self._modes
        if modes is not None and not modes.shows(status.mode, status.publish_ns):
            return f"one shows the mode {_name(status.mode)}, which was not the mode then"
        level = _UNKNOWN if isnan(status.level) else _FLOAT.pack(status.level)
        if not self._levels.shows(level, status.publish_ns):
            return f"one shows the battery level {status.level:.6g}, which was not known then"
        return self._freshness(status, steady_ns)

    def _freshness(self, status: RecordedStatus, steady_ns: int) -> str:
        assert self._timeouts_ns is not None
        inside = (
            begin_ns
            for begin_ns, end_ns in self._without
            if begin_ns < steady_ns and status.publish_ns <= end_ns
        )
        age_ns = steady_ns - next(inside, self._odometry_ns)
        shortest, longest = self._timeouts_ns
        if not status.is_connected and age_ns < shortest - AGE_NS:
            return "one says that odometry was stale, and it was fresh"
        if status.is_connected and age_ns > longest + AGE_NS:
            return "one says that odometry was fresh, and it was stale"
        return ""


def _packed(level: float | None) -> bytes:
    """Return a battery level as a status shows it."""
    return _FLOAT.pack(level) if is_level(level) else _UNKNOWN


def _name(mode: int) -> str:
    return Mode(mode).name if mode in [each.value for each in Mode] else str(mode)
