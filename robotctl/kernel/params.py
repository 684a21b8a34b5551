"""The parameters of the kernel, each with its default, limits and unit."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from robotctl.kernel.fence import FenceParams
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.ranges import Change, bounded, frame, setting, topic
from robotctl.kernel.safety_inputs import SafetyInputParams, Use


@dataclass(frozen=True, slots=True)
class VelocityLimits:
    """The largest velocity of a command, and its largest change per second."""

    linear_mps: float = bounded(0.6, 0.01, 10.0, "m/s", "largest speed of a command")
    angular_rps: float = bounded(1.5, 0.01, 20.0, "rad/s", "largest turning rate of a command")
    linear_accel_mps2: float = bounded(
        1.0, 0.01, 20.0, "m/s^2", "largest change of the speed, also when ramping down"
    )
    angular_accel_rps2: float = bounded(
        4.0, 0.01, 60.0, "rad/s^2", "largest change of the turning rate"
    )
    accel_rise_s: float = bounded(
        0.08, 0.0, 0.5, "s", "time in which an acceleration builds up on a path (jerk limit)"
    )


@dataclass(frozen=True, slots=True)
class TrackingParams:
    """The parameters of path tracking."""

    k_x: float = bounded(3.5, 0.0, 100.0, "1/s", "gain of the error along the path")
    k_y: float = bounded(20.0, 0.0, 1000.0, "1/m^2", "gain of the error across the path")
    k_theta: float = bounded(5.0, 0.0, 100.0, "1/s", "gain of the error in heading")
    max_error_m: float = bounded(
        0.5, 0.01, 100.0, "m", "distance from the reference at which the robot stops"
    )
    lag_s: float = bounded(
        0.06, 0.0, 0.5, "s", "time that the base needs to follow a command; commands lead by it"
    )


class Stamping(Enum):
    """The type of commands; AUTO is the type of the base's subscription."""

    AUTO = "auto"
    TRUE = "true"
    FALSE = "false"


class CommandQos(Enum):
    """The QoS of the command's publisher; a reliable subscription does not match BEST_EFFORT."""

    RELIABLE = "reliable"
    BEST_EFFORT = "best-effort"
    TRANSIENT_LOCAL = "transient-local"


class OdometryQos(Enum):
    """The QoS of the odometry subscription; BEST_EFFORT matches every publisher."""

    BEST_EFFORT = "best-effort"
    RELIABLE = "reliable"


class WhenIdle(Enum):
    """What is sent in IDLE: zero commands; or, if SILENT, zeros for one second and then nothing."""

    ZEROS = "zeros"
    SILENT = "silent"


class Foreign(Enum):
    """The effect of other nodes that publish velocity commands.

    ERROR: any publisher, even a silent one, forbids motion. WARN: publishers only cause a warning.
    YIELD: their commands forbid motion, a silent publisher does not.
    """

    ERROR = "error"
    WARN = "warn"
    YIELD = "yield"


@dataclass(frozen=True, slots=True)
class CommandParams:
    """The topic, type and QoS of the velocity command, and the rules for other senders."""

    topic: str = topic("cmd_vel", "topic of the velocity command")
    stamped: Stamping = setting(
        Stamping.AUTO, "TwistStamped, Twist, or what the base takes", Change.START
    )
    frame_id: str = frame("base_link", "frame of a TwistStamped")
    qos: CommandQos = setting(CommandQos.RELIABLE, "QoS that the command offers", Change.START)
    when_idle: WhenIdle = setting(WhenIdle.ZEROS, "what is sent in IDLE", Change.START)
    lock_topic: str = setting(
        "",
        "std_msgs/Bool, true in ERROR and EMERGENCY_STOP",
        Change.START,
        topic=True,
        optional=True,
    )
    foreign: Foreign = setting(Foreign.ERROR, "what commands of others lead to", Change.START)


@dataclass(frozen=True, slots=True)
class OdometryParams:
    """The topic of the odometry, and the limits of its age and jumps."""

    topic: str = topic("odom", "topic of the odometry")
    timeout_s: float = bounded(0.5, 0.05, 10.0, "s", "age at which odometry counts as lost")
    max_jump_m: float = bounded(
        0.5, 0.01, 100.0, "m", "step between two samples that counts as a jump"
    )
    max_jump_rad: float = bounded(
        1.0, 0.01, 3.2, "rad", "turn between two samples that counts as one"
    )
    frame_id: str = frame("", "frame that odometry must name", optional=True)
    qos: OdometryQos = setting(OdometryQos.BEST_EFFORT, "QoS that is asked of it", Change.START)


class BatteryScale(Enum):
    """The level of a full battery, 1 (REP-147) or 100; AUTO is 1 until a level above 1.05."""

    AUTO = "auto"
    ONE = "1"
    PERCENT = "100"


@dataclass(frozen=True, slots=True)
class BatteryParams:
    """The topic of the battery, "" if there is none, and the limits of its level."""

    topic: str = topic("battery_state", "topic of the battery", optional=True)
    scale: BatteryScale = setting(BatteryScale.ONE, "the level of a full battery", Change.START)
    stop_level: float = bounded(0.15, 0.0, 1.0, about="level at which the robot stops")
    clear_level: float = bounded(
        0.20, 0.0, 1.0, about="level at which a stop for the battery may be released"
    )
    warn_level: float = bounded(0.30, 0.0, 1.0, about="level below which `status` warns")
    timeout_s: float = bounded(5.0, 0.5, 600.0, "s", "age at which the level counts as unknown")


@dataclass(frozen=True, slots=True)
class ScanParams:
    """A sensor_msgs/LaserScan topic, the place of the scanner, and the size of the robot.

    The robot is a rectangle around its centre. Its braking distance adds to `stop_distance_m`.
    """

    use: Use = setting(Use.OFF, "obstacles in a laser scan", Change.START)
    topic: str = topic("scan", "its topic")
    timeout_s: float = bounded(0.5, 0.05, 60.0, "s", "silence after which it is lost", Change.START)
    stop_distance_m: float = bounded(0.3, 0.0, 10.0, "m", "distance at which the robot stops")
    half_width_m: float = bounded(0.25, 0.01, 10.0, "m", "from the centre to a side")
    half_length_m: float = bounded(0.25, 0.01, 10.0, "m", "from the centre to the front")
    x_m: float = bounded(0.0, -10.0, 10.0, "m", "scanner ahead of the centre")
    y_m: float = bounded(0.0, -10.0, 10.0, "m", "scanner left of the centre")
    yaw_rad: float = bounded(0.0, -3.2, 3.2, "rad", "direction of the scanner, to the left")


@dataclass(frozen=True, slots=True)
class KernelParams:
    """All parameters of the kernel."""

    rate_hz: float = bounded(50.0, 5.0, 1000.0, "Hz", "rate of the commands", Change.START)
    max_tick_gap_s: float = bounded(
        0.3, 0.05, 5.0, "s", "time without a control tick after which the robot stops"
    )
    command: CommandParams = field(default_factory=CommandParams)
    limits: VelocityLimits = field(default_factory=VelocityLimits)
    tracking: TrackingParams = field(default_factory=TrackingParams)
    odometry: OdometryParams = field(default_factory=OdometryParams)
    battery: BatteryParams = field(default_factory=BatteryParams)
    pattern: Pattern = field(default_factory=Pattern)
    fence: FenceParams = field(default_factory=FenceParams)
    scan: ScanParams = field(default_factory=ScanParams)
    inputs: SafetyInputParams = field(default_factory=SafetyInputParams)
    guard: bool = setting(False, "MOVING limits the velocities that others want", Change.START)
    guard_topic: str = topic("cmd_vel_nav", "topic of the velocities that others want")
    guard_timeout_s: float = bounded(
        0.25, 0.02, 2.0, "s", "silence of it after which the command is zero", Change.START
    )
    remote_motion: bool = setting(
        False, "nodes of other hosts may start motion over ROS", Change.START
    )
