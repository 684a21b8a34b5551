"""The measurements that a check compares with the recorded statuses."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple, Protocol

from robotctl.kernel.battery import counts_in_percent, level_of
from robotctl.kernel.health import Health
from robotctl.kernel.params import BatteryScale
from robotctl.kernel.types import BatteryReceived, Event, OdomReceived


class MeasuredState(Protocol):
    """The last measurements: the health of a kernel, or what stands in for it."""

    @property
    def odometry_t_ns(self) -> int:
        """When new odometry last came."""

    @property
    def battery_level(self) -> float | None:
        """The battery level, None before the first one."""


class Measurement(NamedTuple):
    """What was measured at a time."""

    odometry_t_ns: int
    battery_level: float | None


class Followed:
    """The measurements of a piece of the journal that was re-run elsewhere."""

    def __init__(self, health: Health, scale: BatteryScale, unused: Collection[int]) -> None:
        """Begin with the health in a snapshot.

        `unused` are the numbers of the entries whose odometry the kernel did not take as new.
        """
        self.measured = Measurement(health.odometry_t_ns, health.battery_level)
        self._in_percent = health.battery_in_percent
        self._scale = scale
        self._unused = unused

    def step(self, seq: int, event: Event) -> Measurement:
        """Take an event, with the number of its entry; return what is measured after it."""
        if isinstance(event, OdomReceived):
            if seq not in self._unused:
                self.measured = Measurement(event.t_ns, self.measured.battery_level)
        elif isinstance(event, BatteryReceived):
            self._in_percent = counts_in_percent(event.level, self._in_percent, self._scale)
            level = level_of(event.level, self._in_percent)
            self.measured = Measurement(self.measured.odometry_t_ns, level)
        return self.measured
