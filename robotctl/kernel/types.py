"""The values of the kernel: measurements, events (its input) and effects (its output).

Every event carries its steady time `t_ns` in nanoseconds: the kernel has no clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.remedies import Remedy


@dataclass(frozen=True, slots=True)
class Twist:
    """A velocity in the robot's own frame: linear [m/s] forward, angular [rad/s] to the left."""

    linear: float = 0.0
    angular: float = 0.0


ZERO = Twist()


@dataclass(frozen=True, slots=True)
class Odometry:
    """A sample of odometry: pose in the `odom` frame, velocity in the robot's own, header stamp."""

    pose: Pose
    velocity: Twist
    stamp_ns: int


class Cause(Enum):
    """Why the robot may not move; `robotctl.kernel.safety` says what each cause leads to."""

    OPERATOR_STOP = "operator stop"
    BATTERY_LOW = "battery low"
    TASK_DIED = "task died"
    LOOP_STALLED = "loop stalled"
    RECORDER_FAILED = "recorder failed"
    UNREACHABLE = "unreachable"
    DAEMON_ENDS = "daemon ends"
    ODOMETRY_WRONG = "odometry wrong"
    ODOMETRY_LOST = "odometry lost"
    ODOMETRY_CONTRADICTED = "odometry contradicted"
    SECOND_ODOMETRY = "second odometry source"
    TRACKING_LOST = "tracking lost"
    FOREIGN_PUBLISHER = "foreign publisher"
    COMMAND_UNHEARD = "command unheard"
    TICK_OVERRUN = "tick overrun"
    BATTERY_UNKNOWN = "battery unknown"
    OPERATOR_ERROR = "operator error"


class Phase(Enum):
    """What the robot is doing within its mode."""

    STANDING = "standing"
    DRIVING = "driving"
    STOPPING = "stopping"


# Events


@dataclass(frozen=True, slots=True)
class Tick:
    """The next command is due; `missed` ticks before it were skipped."""

    t_ns: int
    missed: int = 0


@dataclass(frozen=True, slots=True)
class OdomReceived:
    """A sample of odometry arrived; its values may be anything, also NaN.

    `source` is the number of the publisher (see `OdometrySourceFound`), 0 if unknown. `sequence`
    is the number that the publisher gave the sample.
    """

    t_ns: int
    odometry: Odometry
    source: int = 0
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class OdometrySourceFound:
    """A publisher of odometry sent its first sample, or its node name became known.

    `source` is its number from now on, `gid` its DDS identity, `name` its node name or "".
    """

    t_ns: int
    source: int
    gid: str
    name: str


@dataclass(frozen=True, slots=True)
class BatteryReceived:
    """The battery level as the gauge reports it; `battery.scale` says which value is full."""

    t_ns: int
    level: float


@dataclass(frozen=True, slots=True)
class ModeRequested:
    """A request for a mode by its number, valid or not; it gets one `Reply`."""

    t_ns: int
    request_id: int
    requested: int
    source: str


@dataclass(frozen=True, slots=True)
class ResetRequested:
    """A request to leave EMERGENCY_STOP or ERROR; it gets one `Reply`."""

    t_ns: int
    request_id: int
    source: str


@dataclass(frozen=True, slots=True)
class DriveRequested:
    """A request to drive `laps` laps (0: until stopped) of a pattern; it gets one `Reply`."""

    t_ns: int
    request_id: int
    pattern: Pattern
    laps: int
    replace: bool
    source: str


@dataclass(frozen=True, slots=True)
class CommandPublishersSeen:
    """The other nodes that publish the command topic now."""

    t_ns: int
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ForeignCommandHeard:
    """Another node published a velocity command."""

    t_ns: int
    publisher: str


@dataclass(frozen=True, slots=True)
class CommandListenersSeen:
    """The number of subscriptions to the command topic with the type that robotctl sends.

    `other_types` are the types of the other subscriptions to that topic.
    """

    t_ns: int
    count: int
    other_types: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LoopStalled:
    """The control loop stalled for `stalled_s` seconds, and the watchdog sent zeros meanwhile.

    It sent `zeros` zero commands without the kernel and withheld `withheld` commands of the
    kernel. `detail` says what blocked the loop.
    """

    t_ns: int
    stalled_s: float
    zeros: int
    withheld: int
    detail: str


@dataclass(frozen=True, slots=True)
class FaultReported:
    """A part of the daemon failed; `detail` says how."""

    t_ns: int
    cause: Cause
    detail: str


@dataclass(frozen=True, slots=True)
class FaultCleared:
    """A part of the daemon works again."""

    t_ns: int
    cause: Cause


Event = (
    Tick
    | OdomReceived
    | BatteryReceived
    | ModeRequested
    | ResetRequested
    | DriveRequested
    | OdometrySourceFound
    | CommandPublishersSeen
    | ForeignCommandHeard
    | CommandListenersSeen
    | LoopStalled
    | FaultReported
    | FaultCleared
)
"""Everything that `Kernel.step` takes."""


# Effects


@dataclass(frozen=True, slots=True)
class PublishTwist:
    """A velocity command to send to the robot."""

    twist: Twist


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """The mode changed; `cause` is why it is ERROR or EMERGENCY_STOP now."""

    previous: Mode
    mode: Mode
    reason: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class LatchEmergencyStop:
    """An emergency stop that must be kept over restarts; a cause of None means the operator."""

    reason: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class ReleaseEmergencyStop:
    """The release of the latched emergency stop."""


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a request; `remedies` says what to do, in order, after a refusal."""

    request_id: int
    ok: bool
    message: str
    mode: Mode
    remedies: tuple[Remedy, ...] = ()


@dataclass(frozen=True, slots=True)
class DriveReport:
    """How well a drive followed its path, by odometry.

    `closure_m` is the distance between the start of the drive and the end of its last complete
    lap, NaN before one is complete.
    """

    laps: int
    distance_m: float
    cross_track_rms_m: float
    cross_track_max_m: float
    closure_m: float


@dataclass(frozen=True, slots=True)
class DriveEnded:
    """The drive that `request_id` began has ended; `completed` means all its laps were driven.

    `cause` is why the robot had to stop, None where a request or the last lap ended the drive.
    """

    request_id: int
    completed: bool
    reason: str
    report: DriveReport
    cause: Cause | None = None


Decision = PublishTwist | ModeChanged | LatchEmergencyStop | ReleaseEmergencyStop | Reply
"""The effects that a kernel of another version must decide as well."""

Effect = Decision | DriveEnded
"""Everything that `Kernel.step` returns."""
