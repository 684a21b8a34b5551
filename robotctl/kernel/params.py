"""The parameters of the kernel, each with its default, limits and unit.

`robotctl.config` checks a configuration file against these limits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from robotctl.kernel.patterns import Pattern
from robotctl.kernel.ranges import bounded, topic


@dataclass(frozen=True, slots=True)
class VelocityLimits:
    """The largest velocity of a command, and the largest change of it per second."""

    linear_mps: float = bounded(0.6, 0.01, 10.0, "m/s")
    angular_rps: float = bounded(1.5, 0.01, 20.0, "rad/s")
    linear_accel_mps2: float = bounded(1.0, 0.01, 20.0, "m/s^2")
    angular_accel_rps2: float = bounded(4.0, 0.01, 60.0, "rad/s^2")


@dataclass(frozen=True, slots=True)
class TrackingParams:
    """The gains of the tracking law, and the largest distance from the reference."""

    k_x: float = bounded(3.5, 0.0, 100.0, "1/s")
    k_y: float = bounded(20.0, 0.0, 1000.0, "1/m^2")
    k_theta: float = bounded(5.0, 0.0, 100.0, "1/s")
    max_error_m: float = bounded(0.5, 0.01, 100.0, "m")


@dataclass(frozen=True, slots=True)
class CommandParams:
    """The topic of the velocity command."""

    topic: str = topic("cmd_vel")


@dataclass(frozen=True, slots=True)
class OdometryParams:
    """The topic of the odometry, and the limits beyond which it is lost or wrong."""

    topic: str = topic("odom")
    timeout_s: float = bounded(0.5, 0.05, 10.0, "s")
    max_jump_m: float = bounded(0.5, 0.01, 100.0, "m")
    max_jump_rad: float = bounded(1.0, 0.01, 3.2, "rad")


class BatteryScale(Enum):
    """The value of a full battery: 1 (REP-147), 100, or 100 once a level above 1 was seen."""

    AUTO = "auto"
    ONE = "1"
    PERCENT = "100"


@dataclass(frozen=True, slots=True)
class BatteryParams:
    """The topic of the battery ("" for a robot without one), and the levels that allow motion."""

    topic: str = topic("battery_state", optional=True)
    scale: BatteryScale = BatteryScale.ONE
    stop_level: float = bounded(0.15, 0.0, 1.0)
    clear_level: float = bounded(0.20, 0.0, 1.0)
    timeout_s: float = bounded(5.0, 0.5, 600.0, "s")


@dataclass(frozen=True, slots=True)
class KernelParams:
    """All parameters of `Kernel.step`."""

    rate_hz: float = bounded(50.0, 5.0, 1000.0, "Hz")
    max_tick_gap_s: float = bounded(0.3, 0.05, 5.0, "s")
    command: CommandParams = field(default_factory=CommandParams)
    limits: VelocityLimits = field(default_factory=VelocityLimits)
    tracking: TrackingParams = field(default_factory=TrackingParams)
    odometry: OdometryParams = field(default_factory=OdometryParams)
    battery: BatteryParams = field(default_factory=BatteryParams)
    pattern: Pattern = field(default_factory=Pattern)
