"""The measurements, events and effects of the kernel; `t_ns` is steady time [ns]."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from math import nan
from typing import Any, TypeVar

from robotctl.kernel.constants import TWIST
from robotctl.kernel.course import PLAIN, Course
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.safety_inputs import SafetyInput


@dataclass(frozen=True, slots=True)
class Twist:
    """A velocity in the robot's own frame: linear [m/s] forward, angular [rad/s] to the left."""

    linear: float = 0.0
    angular: float = 0.0


ZERO = Twist()


@dataclass(frozen=True, slots=True)
class Odometry:
    """An odometry sample, with `pose` in the `odom` frame and `velocity` in the robot's frame."""

    pose: Pose
    velocity: Twist
    stamp_ns: int


T = TypeVar("T")


def changed(value: T, **changes: Any) -> T:
    """Return a copy of a frozen dataclass without slots, with changed fields."""
    # Each step copies some dataclasses: `dataclasses.replace` is far slower.
    fields = value.__dict__ | changes
    # A value that msgspec read from a journal has no entries for fields at their default.
    assert len(fields) <= len(vars(type(value))["__dataclass_fields__"]), changes
    copy = object.__new__(type(value))
    object.__setattr__(copy, "__dict__", fields)
    return copy


class Cause(Enum):
    """A reason to stop the robot or to refuse its motion."""

    OPERATOR_STOP = "operator stop"
    ESTOP_PRESSED = "emergency stop pressed"
    ESTOP_SILENT = "emergency stop silent"
    BATTERY_LOW = "battery low"
    TASK_DIED = "task died"
    LOOP_STALLED = "loop stalled"
    RECORDER_FAILED = "recorder failed"
    UNREACHABLE = "unreachable"
    DAEMON_ENDS = "daemon ends"
    NOT_ACTIVE = "not active"
    ODOMETRY_WRONG = "odometry wrong"
    ODOMETRY_LOST = "odometry lost"
    ODOMETRY_CONTRADICTED = "odometry contradicted"
    SECOND_ODOMETRY = "second odometry source"
    TRACKING_LOST = "tracking lost"
    FENCE_LEFT = "fence left"
    OBSTACLE_NEAR = "obstacle near"
    SCAN_LOST = "scan lost"
    BUMPER_PRESSED = "bumper pressed"
    TILTED = "tilted"
    BASE_FAULT = "base fault"
    INPUT_LOST = "input lost"
    FOREIGN_PUBLISHER = "foreign publisher"
    COMMAND_UNHEARD = "command unheard"
    COMMAND_TYPES_MIXED = "command types mixed"
    TOPIC_TROUBLE = "topic trouble"
    TICK_OVERRUN = "tick overrun"
    BATTERY_UNKNOWN = "battery unknown"
    OPERATOR_ERROR = "operator error"


class Phase(Enum):
    """The activity of the robot within its mode."""

    STANDING = "standing"
    DRIVING = "driving"
    STOPPING = "stopping"


@dataclass(frozen=True, slots=True)
class Lease:
    """The exclusive right of one client to start motion; `source` is the client's name."""

    client: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LeaseRequested:
    """A request to take the lease, or to release it if `take` is False."""

    t_ns: int
    request_id: int
    take: bool
    client: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LeaseLost:
    """The holder of the lease has disconnected or is silent."""

    t_ns: int
    client: int
    how: str = "its connection closed"


@dataclass(frozen=True, slots=True)
class ParameterRequested:
    """A request to change the parameter `key` from the text `old` to the text `new`.

    The text of a float is its repr. The daemon has checked parameters that are not the kernel's.
    """

    t_ns: int
    request_id: int
    key: str
    old: str
    new: str
    source: str


@dataclass(frozen=True, slots=True)
class ParameterChanged:
    """A parameter has a new value from now on."""

    key: str
    old: str
    new: str
    source: str


class LifecycleState(Enum):
    """The primary states of a managed node by their labels; motion starts in ACTIVE only."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


@dataclass(frozen=True, slots=True)
class LifecycleChanged:
    """The lifecycle node `source` has changed to `state`."""

    t_ns: int
    state: LifecycleState
    source: str


@dataclass(frozen=True, slots=True)
class Tick:
    """The next command is due, after `missed` skipped ticks."""

    t_ns: int
    missed: int = 0


@dataclass(frozen=True, slots=True)
class OdomReceived:
    """A sample of odometry; its values are unchecked and may be NaN.

    `source` is the number of its publisher, 0 if unknown; `sequence` is the sample's number.
    """

    t_ns: int
    odometry: Odometry
    source: int = 0
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class OdometrySourceFound:
    """A publisher of odometry is new, or its node name or frame became known or changed.

    `source` is its number from now on, `gid` its DDS identity, `name` its node name or "".
    `frame_id` is the frame of its samples, "" if unknown.
    """

    t_ns: int
    source: int
    gid: str
    name: str
    frame_id: str = ""


@dataclass(frozen=True, slots=True)
class BatteryReceived:
    """The raw battery level in message `sequence` of the gauge `publisher` (a DDS identity)."""

    t_ns: int
    level: float
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class SafetyInputReceived:
    """A message of a safety input; not every repeated value becomes an event."""

    t_ns: int
    kind: SafetyInput
    value: float
    detail: str = ""
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class ScanReceived:
    """The nearest range of a laser scan in each sector [m], counter-clockwise from straight behind.

    The range of an empty sector is inf; `sectors` is () if the message is unreadable.
    """

    t_ns: int
    sectors: tuple[float, ...]
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class ModeRequested:
    """A request for the mode number `requested`, which may be invalid.

    `client` is the lease holder's number, 0 for others. If `remote`, another host may have sent it.
    """

    t_ns: int
    request_id: int
    requested: int
    source: str
    client: int = 0
    reason: str = ""
    remote: bool = False


@dataclass(frozen=True, slots=True)
class ResetRequested:
    """A request to leave EMERGENCY_STOP or ERROR."""

    t_ns: int
    request_id: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class DriveRequested:
    """A request to drive `laps` laps of a pattern, 0 for no end.

    With `replace`, the drive may replace a running drive. `course` may replace the pattern by
    waypoints or a held velocity. `client` and `remote` are as in `ModeRequested`.
    """

    t_ns: int
    request_id: int
    pattern: Pattern
    laps: int
    replace: bool
    source: str
    client: int = 0
    reason: str = ""
    course: Course = PLAIN
    remote: bool = False


@dataclass(frozen=True, slots=True)
class HoldReceived:
    """A repeated hold-to-run request for the drive `hold`; its velocity may be NaN."""

    t_ns: int
    hold: int
    twist: Twist
    client: int = 0


@dataclass(frozen=True, slots=True)
class CommandPublishersSeen:
    """The nodes, except robotctl's own, that have a publisher on the command topic now."""

    t_ns: int
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ForeignCommandHeard:
    """Another node, `publisher`, published a velocity command."""

    t_ns: int
    publisher: str


@dataclass(frozen=True, slots=True)
class CommandListenersSeen:
    """Subscriptions to the command topic: how many have its `type_name`, and the other types."""

    t_ns: int
    count: int
    other_types: tuple[str, ...]
    type_name: str = TWIST


@dataclass(frozen=True, slots=True)
class GuardedCommandReceived:
    """A steering node's velocity, which is unchecked and may be NaN."""

    t_ns: int
    twist: Twist
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class LoopStalled:
    """The control loop stalled for `stalled_s` seconds; `detail` names the blocking code.

    A watchdog sent `zeros` zero commands; `withheld` commands of the kernel were not sent.
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
    | SafetyInputReceived
    | ScanReceived
    | LifecycleChanged
    | ModeRequested
    | ResetRequested
    | DriveRequested
    | ParameterRequested
    | LeaseRequested
    | LeaseLost
    | GuardedCommandReceived
    | HoldReceived
    | OdometrySourceFound
    | CommandPublishersSeen
    | ForeignCommandHeard
    | CommandListenersSeen
    | LoopStalled
    | FaultReported
    | FaultCleared
)
"""Everything that `Kernel.step` accepts."""


class Remedy(Enum):
    """One thing that the operator can do; `robotctl.ipc.advice` has its text."""

    RELEASE_STOP = "release the emergency stop"
    CLEAR_ERROR = "clear the error"
    RESET = "reset"
    STOP_FIRST = "stop first"
    STOP_OR_REPLACE = "stop first or replace the drive"
    CHARGE_BATTERY = "charge the battery"
    CHECK_BATTERY_TOPIC = "check the battery topic"
    READ_LOG_AND_RESTART = "read the log and restart"
    RESTART = "restart"
    RESTORE_SOCKET_FOLDER = "restore the socket folder"
    START_DAEMON = "start the daemon"
    FREE_PROCESSOR = "free the processor"
    FREE_PROCESSOR_OR_LOWER_RATE = "free the processor or lower the rate"
    CHECK_ODOMETRY_SOURCE = "check the odometry source"
    CHECK_ODOMETRY_IS_PUBLISHED = "check that odometry is published"
    STOP_ONE_ODOMETRY_PUBLISHER = "stop one odometry publisher"
    RELEASE_BUTTON = "release the button"
    CHECK_INPUT = "check the safety input"
    FREE_ROBOT = "free the robot"
    BRING_BACK = "bring the robot back"
    CLEAR_PATH = "clear the path"
    CHECK_SCAN = "check the scan"
    CHECK_BASE = "check the base"
    CHECK_WHEELS = "check the wheels"
    STOP_COMMAND_PUBLISHER = "stop the other command publisher"
    START_BASE = "start the base"
    ACTIVATE = "activate the node"
    ASK_HERE = "ask on this host"
    WAIT_FOR_LEASE = "wait for the lease"
    SET_COMMAND_TYPE = "set the command's type"
    CHECK_TOPIC = "check the topic's publisher"


RESETTING = frozenset({Remedy.RELEASE_STOP, Remedy.CLEAR_ERROR, Remedy.RESET})
"""The remedies that are a reset. After another remedy, a reset is still needed."""


@dataclass(frozen=True, slots=True)
class PublishTwist:
    """A velocity command to send to the robot."""

    twist: Twist


@dataclass(frozen=True, slots=True)
class ModeChanged:
    """The mode changed; `cause` is that of ERROR or EMERGENCY_STOP, else None."""

    previous: Mode
    mode: Mode
    reason: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class LatchEmergencyStop:
    """An emergency stop that must survive restarts; `cause` None stands for the operator."""

    reason: str
    cause: Cause | None = None


@dataclass(frozen=True, slots=True)
class ReleaseEmergencyStop:
    """The release of the latched emergency stop."""


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a request; after a refusal, `remedies` are the operator's steps, in order."""

    request_id: int
    ok: bool
    message: str
    mode: Mode
    remedies: tuple[Remedy, ...] = ()


@dataclass(frozen=True, slots=True)
class DriveReport:
    """The length and the tracking errors of a drive, by odometry.

    `closure_m` is the robot's distance from the path's end after the last complete lap, NaN before.
    The four errors of a held velocity are 0. Older versions have NaN in the last three fields.
    """

    laps: int
    distance_m: float
    cross_track_rms_m: float
    cross_track_max_m: float
    closure_m: float
    heading_rms_rad: float = nan
    heading_max_rad: float = nan
    duration_s: float = nan

    def without_errors(self) -> DriveReport:
        """Return a copy whose four tracking errors are NaN."""
        return replace(
            self,
            cross_track_rms_m=nan,
            cross_track_max_m=nan,
            heading_rms_rad=nan,
            heading_max_rad=nan,
        )


@dataclass(frozen=True, slots=True)
class DriveEnded:
    """The drive of `request_id` ended; `cause` is that of ERROR or EMERGENCY_STOP, else None."""

    request_id: int
    completed: bool
    reason: str
    report: DriveReport
    cause: Cause | None = None


Decision = (
    PublishTwist
    | ModeChanged
    | LatchEmergencyStop
    | ReleaseEmergencyStop
    | Reply
    | ParameterChanged
)
"""The effects that must be the same in all versions of the kernel, given the same events."""

Effect = Decision | DriveEnded
"""Everything that `Kernel.step` returns."""
