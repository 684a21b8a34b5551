"""Every number that shapes a decision of the kernel, with its unit and its limits.

The limits stand beside the defaults; `robotctl.config` reads both and checks a file against them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from robotctl.kernel.patterns import Pattern
from robotctl.kernel.ranges import bounded, topic


@dataclass(frozen=True, slots=True)
class VelocityLimits:
    """The fastest command, and how fast a command may change."""

    linear_mps: float = bounded(0.6, 0.01, 10.0, "m/s")
    angular_rps: float = bounded(1.5, 0.01, 20.0, "rad/s")
    linear_accel_mps2: float = bounded(1.0, 0.01, 20.0, "m/s^2")
    angular_accel_rps2: float = bounded(4.0, 0.01, 60.0, "rad/s^2")


@dataclass(frozen=True, slots=True)
class TrackingParams:
    """Gains of the path tracking law, and how far from the path the robot may be."""

    k_x: float = bounded(3.5, 0.0, 100.0, "1/s")
    k_y: float = bounded(20.0, 0.0, 1000.0, "1/m^2")
    k_theta: float = bounded(5.0, 0.0, 100.0, "1/s")
    max_error_m: float = bounded(0.5, 0.01, 100.0, "m")


@dataclass(frozen=True, slots=True)
class CommandParams:
    """Where the velocity command goes."""

    topic: str = topic("cmd_vel")


@dataclass(frozen=True, slots=True)
class OdometryParams:
    """Where odometry comes from, and when it counts as lost or as wrong."""

    topic: str = topic("odom")
    timeout_s: float = bounded(0.5, 0.05, 10.0, "s")
    max_jump_m: float = bounded(0.5, 0.01, 100.0, "m")
    max_jump_rad: float = bounded(1.0, 0.01, 3.2, "rad")


class BatteryScale(Enum):
    """What a full battery is: 1 (REP-147), 100, or 100 once a level above 1 was seen."""

    AUTO = "auto"
    ONE = "1"
    PERCENT = "100"


@dataclass(frozen=True, slots=True)
class BatteryParams:
    """When the battery allows motion; a robot that reports none has "" as its topic."""

    topic: str = topic("battery_state", optional=True)
    scale: BatteryScale = BatteryScale.ONE
    stop_level: float = bounded(0.15, 0.0, 1.0)
    clear_level: float = bounded(0.20, 0.0, 1.0)
    timeout_s: float = bounded(5.0, 0.5, 600.0, "s")


@dataclass(frozen=True, slots=True)
class KernelParams:
    """Everything that `Kernel.step` depends on besides its state and the event."""

    rate_hz: float = bounded(50.0, 5.0, 1000.0, "Hz")
    max_tick_gap_s: float = bounded(0.3, 0.05, 5.0, "s")
    command: CommandParams = field(default_factory=CommandParams)
    limits: VelocityLimits = field(default_factory=VelocityLimits)
    tracking: TrackingParams = field(default_factory=TrackingParams)
    odometry: OdometryParams = field(default_factory=OdometryParams)
    battery: BatteryParams = field(default_factory=BatteryParams)
    pattern: Pattern = field(default_factory=Pattern)
