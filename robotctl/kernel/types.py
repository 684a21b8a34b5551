"""The vocabulary of the kernel: measurements, the events that come in, the effects that go out.

Every event carries `t_ns`, steady nanoseconds: the kernel has no clock of its own.
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
    """One measurement: pose in the `odom` frame, velocity in the robot's; stamp of its header."""

    pose: Pose
    velocity: Twist
    stamp_ns: int


class Cause(Enum):
    """Why the robot may not move; `robotctl.kernel.safety` holds what each one leads to."""

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
    """What the robot does within its mode."""

    STANDING = "standing"
    DRIVING = "driving"
    STOPPING = "stopping"


# Events


@dataclass(frozen=True, slots=True)
class Tick:
    """Time for the next command; `missed` ticks were skipped before this one."""

    t_ns: int
    missed: int = 0


@dataclass(frozen=True, slots=True)
class OdomReceived:
    """The robot measured where it is; values may be anything, also NaN.

    `source` is the number of the publisher (`OdometrySourceFound`), 0 if unknown, and `sequence`
    the publisher's own number of the sample.
    """

    t_ns: int
    odometry: Odometry
    source: int = 0
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class OdometrySourceFound:
    """A publisher of odometry sent its first sample, or its node became known.

    From now on `source` is its number; `gid` is its DDS identity in hexadecimal digits, and `name`
    its node, "" where that is not known yet.
    """

    t_ns: int
    source: int
    gid: str
    name: str


@dataclass(frozen=True, slots=True)
class BatteryReceived:
    """The battery's level as the gauge reports it; `battery.scale` says what is full."""

    t_ns: int
    level: float


@dataclass(frozen=True, slots=True)
class ModeRequested:
    """Somebody asks for a mode by its number, valid or not; answered by one Reply."""

    t_ns: int
    request_id: int
    requested: int
    source: str


@dataclass(frozen=True, slots=True)
class ResetRequested:
    """Somebody asks to release EMERGENCY_STOP or ERROR; answered by one Reply."""

    t_ns: int
    request_id: int
    source: str


@dataclass(frozen=True, slots=True)
class DriveRequested:
    """Somebody asks to drive a pattern, `laps` times (0: until stopped); answered by one Reply."""

    t_ns: int
    request_id: int
    pattern: Pattern
    laps: int
    replace: bool
    source: str


@dataclass(frozen=True, slots=True)
class CommandPublishersSeen:
    """The nodes, other than ours, that publish the command topic now."""

    t_ns: int
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ForeignCommandHeard:
    """A velocity command that another node published reached the robot's command topic."""

    t_ns: int
    publisher: str


@dataclass(frozen=True, slots=True)
class CommandListenersSeen:
    """How many nodes take the command with the type that we send.

    `other_types` are the types with which others subscribe to the same topic.
    """

    t_ns: int
    count: int
    other_types: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class LoopStalled:
    """The control loop did not turn for `stalled_s`, and the watchdog stood in for it.

    It sent `zeros` zero commands past the kernel, and replaced `withheld` commands of the kernel
    by zeros; `detail` says what held the loop up.
    """

    t_ns: int
    stalled_s: float
    zeros: int
    withheld: int
    detail: str


@dataclass(frozen=True, slots=True)
class FaultReported:
    """A part of the daemon failed; `detail` says what."""

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
    """Send this command to the robot."""

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
    """Remember the emergency stop over restarts; a cause of None is the operator."""

    reason: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class ReleaseEmergencyStop:
    """Forget the latched emergency stop."""


@dataclass(frozen=True, slots=True)
class Reply:
    """The one answer to a request; `remedies` is what to do, in order, about a refusal."""

    request_id: int
    ok: bool
    message: str
    mode: Mode
    remedies: tuple[Remedy, ...] = ()


@dataclass(frozen=True, slots=True)
class DriveReport:
    """How well a path was followed, measured against odometry.

    `closure_m` is the distance between where the drive began and where its last whole lap ended,
    NaN before a lap is whole.
    """

    laps: int
    distance_m: float
    cross_track_rms_m: float
    cross_track_max_m: float
    closure_m: float


@dataclass(frozen=True, slots=True)
class DriveEnded:
    """The drive that `request_id` began is over; `completed` means all its laps were driven.

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
