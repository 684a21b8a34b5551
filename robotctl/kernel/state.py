"""The memory of the kernel between two events."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite
from typing import TypeGuard

from robotctl.kernel.constants import NS_PER_S, TWIST
from robotctl.kernel.drive import Drive
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import BatteryScale
from robotctl.kernel.safety_inputs import Reading
from robotctl.kernel.types import ZERO, Cause, Lease, LifecycleState, Odometry, Phase, Twist


@dataclass(frozen=True, slots=True)
class SecondOdometry:
    """The last odometry of a publisher that is not followed, compared with the one that is."""

    source: int
    t_ns: int
    distance_m: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class OdometrySources:
    """The publishers of odometry by number; the robot follows number `followed`.

    `names` has pairs of number and node name, `frames` of number and frame. `dropped` counts unused
    samples.
    """

    followed: int = 0
    names: tuple[tuple[int, str], ...] = ()
    dropped: int = 0
    second: SecondOdometry | None = None
    frames: tuple[tuple[int, str], ...] = ()

    def name_of(self, source: int) -> str:
        """Return the node name of a publisher, or a phrase if it is unknown."""
        return dict(self.names).get(source) or "a publisher without a name"


@dataclass(frozen=True, slots=True)
class CommandTopic:
    """Other nodes on the velocity command topic.

    `foreign_t_ns` and `foreign_by` are of the last command of another node, None and "" before it.
    `listeners` counts the subscriptions with `type_name`, None before discovery. `other_types` are
    the types of all other subscriptions.
    """

    foreign_t_ns: int | None = None
    foreign_by: str = ""
    listeners: int | None = None
    other_types: tuple[str, ...] = ()
    type_name: str = TWIST


@dataclass(frozen=True, slots=True)
class Stalls:
    """The number of stalls of the control loop; time, length and reason of the last stall."""

    count: int = 0
    last_t_ns: int = 0
    last_s: float = 0.0
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Scan:
    """The last laser scan: `sectors` has the nearest range [m] by direction, () if unreadable.

    `ahead_m` is the distance to the nearest obstacle in the path of the command, inf if none.
    """

    t_ns: int
    sectors: tuple[float, ...]
    nearest_m: float = inf
    ahead_m: float = inf


@dataclass(frozen=True)
class Health:
    """The kernel's knowledge of the robot and its sensors.

    - `odometry`: the last usable sample of the followed publisher.
    - `odometry_t_ns`: when its last sample came that had no fault and was no repetition.
    - `odometry_stamp_ns`, `odometry_fault`: of its last sample, usable or not; "" is no fault.
    - `reported`: the faults that the daemon reported and has not cleared.
    - `battery_in_percent`: whether a full battery reports 100 instead of 1.
    - `inputs`: the last readings, in the order of `SafetyInput`; () before the first reading.
    - `fence_origin`: the pose of the robot at the start of the first motion.
    - `lifecycle`: the state of the node `mode_service`.
    """

    odometry: Odometry | None = None
    odometry_t_ns: int = 0
    odometry_stamp_ns: int = 0
    odometry_fault: str = ""
    battery_level: float | None = None
    battery_t_ns: int = 0
    foreign_publishers: tuple[str, ...] = ()
    reported: tuple[tuple[Cause, str], ...] = ()
    path_error_m: float = 0.0
    tick_gap_s: float = 0.0
    odometry_sources: OdometrySources = OdometrySources()
    command_topic: CommandTopic = CommandTopic()
    stalls: Stalls = Stalls()
    battery_in_percent: bool = False
    inputs: tuple[Reading | None, ...] = ()
    fence_origin: Pose | None = None
    scan: Scan | None = None
    lifecycle: LifecycleState = LifecycleState.ACTIVE


UNKNOWN = Health()
"""The health before anything was received."""


@dataclass(frozen=True, slots=True)
class Guarded:
    """A motion that another node steers: its last requested velocity, and when (None if never)."""

    twist: Twist = ZERO
    t_ns: int | None = None

    def wanted(self, t_ns: int, timeout_s: float) -> Twist | None:
        """Return the last requested velocity, None if it is absent, too old or not finite."""
        if self.t_ns is None or abs(t_ns - self.t_ns) / NS_PER_S > timeout_s:
            return None
        twist = self.twist
        return twist if isfinite(twist.linear) and isfinite(twist.angular) else None


@dataclass(frozen=True)
class State:
    """The whole memory of the kernel.

    - `reason`: the reason for the last mode change. `cause`: the cause of ERROR or EMERGENCY_STOP.
    - `stop_reason`: the reason for which the robot ramps down.
    - `waiting`: the ids of the requests for IDLE that are answered at the end of the ramp.
    - `tick_t_ns`: the time of the last tick.
    - `idle_t_ns`: the time of the first tick in IDLE; only with `when_idle: silent`.
    - `silent`: whether no command is sent now, because of `when_idle: silent`.
    - `lease`: the only client that may start motion, None if every client may.
    - `guarded`: set in a motion that another node steers.
    """

    mode: Mode = Mode.IDLE
    phase: Phase = Phase.STANDING
    reason: str = "started"
    cause: Cause | None = None
    command: Twist = ZERO
    tick_t_ns: int | None = None
    health: Health = UNKNOWN
    drive: Drive | None = None
    stop_reason: str = ""
    waiting: tuple[int, ...] = ()
    idle_t_ns: int | None = None
    silent: bool = False
    lease: Lease | None = None
    guarded: Guarded | None = None


def latched(reason: str, cause: Cause = Cause.OPERATOR_STOP) -> State:
    """Return the state after a restart with a latched emergency stop."""
    return State(mode=Mode.EMERGENCY_STOP, reason=reason, cause=cause)


FULLEST_LEVEL = 1.05
"""The highest valid level, as gauges overshoot. A higher value is in percent, or wrong."""


def counts_in_percent(raw: float, before: bool, scale: BatteryScale) -> bool:
    """Return whether levels are in percent; `raw` is the newest level, `before` the last result."""
    if scale is BatteryScale.AUTO:
        return before or FULLEST_LEVEL < raw <= 100.0 * FULLEST_LEVEL
    return scale is BatteryScale.PERCENT


def level_of(raw: float, in_percent: bool) -> float:
    """Return the battery level of the gauge's report `raw`; 1 is full."""
    return raw / 100.0 if in_percent else raw


def full_level(scale: BatteryScale) -> float:
    """Return the value of a full battery on this `scale`."""
    return 100.0 if scale is BatteryScale.PERCENT else 1.0


def is_level(level: float | None) -> TypeGuard[float]:
    """Return whether `level` is a possible battery level; None and NaN are not."""
    return level is not None and 0.0 <= level <= FULLEST_LEVEL
