"""What the robot has measured, as far as a check compares it with what the statuses show."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from robotctl.kernel.battery import counts_in_percent, level_of
from robotctl.kernel.health import Health
from robotctl.kernel.params import BatteryScale
from robotctl.kernel.types import BatteryReceived, Event, OdomReceived


class Measured(Protocol):
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


@dataclass(slots=True)
class Followed:
    """The measurements of a piece of the journal that was re-run elsewhere."""

    odometry_t_ns: int
    battery_level: float | None
    in_percent: bool
    scale: BatteryScale
    unused: Collection[int]
    """The numbers of the entries whose odometry the kernel did not take as new."""

    @classmethod
    def of(cls, health: Health, scale: BatteryScale, unused: Collection[int]) -> Followed:
        """Begin with the health in a snapshot."""
        return cls(
            health.odometry_t_ns, health.battery_level, health.battery_in_percent, scale, unused
        )

    def measurement(self) -> Measurement:
        """Return the last measurements."""
        return Measurement(self.odometry_t_ns, self.battery_level)

    def step(self, seq: int, event: Event) -> None:
        """Take an event, with the number of its entry."""
        if isinstance(event, OdomReceived):
            if seq not in self.unused:
                self.odometry_t_ns = event.t_ns
        elif isinstance(event, BatteryReceived):
            self.in_percent = counts_in_percent(event.level, self.in_percent, self.scale)
            self.battery_level = level_of(event.level, self.in_percent)
