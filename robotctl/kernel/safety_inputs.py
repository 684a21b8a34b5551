"""Inputs that stop the robot, such as buttons, bumper, tilt and diagnostics."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from robotctl.kernel.ranges import Change, bounded, setting, topic


class SafetyInput(Enum):
    """A safety input.

    ESTOP, JOY, BUMPER: 1 means pressed, 0 not pressed. TILT: the angle between the upward axes of
    robot and world [rad]. DIAGNOSTICS: the worst level of a DiagnosticStatus.
    """

    ESTOP = "estop"
    JOY = "joy"
    BUMPER = "bumper"
    TILT = "tilt"
    DIAGNOSTICS = "diagnostics"


class Use(Enum):
    """Whether an input is used. The silence of a required input is a fault."""

    OFF = "off"
    OPTIONAL = "optional"
    REQUIRED = "required"


REPEATS_PER_TIMEOUT = 4
"""The number of events per timeout for an unchanged value."""


@dataclass(frozen=True, slots=True)
class Reading:
    """The last message of an input; `value` is NaN for an unreadable message."""

    kind: SafetyInput
    value: float
    t_ns: int
    detail: str = ""


@dataclass(frozen=True, slots=True)
class EstopParams:
    """A std_msgs/Bool topic; true means pressed."""

    use: Use = setting(Use.OFF, "emergency stop topic", Change.START)
    topic: str = topic("estop_pressed", "its topic")
    timeout_s: float = bounded(0.5, 0.05, 60.0, "s", "silence after which it is lost", Change.START)


@dataclass(frozen=True, slots=True)
class JoyParams:
    """The button of a sensor_msgs/Joy topic that acts as emergency stop."""

    use: Use = setting(Use.OFF, "emergency stop on a gamepad", Change.START)
    topic: str = topic("joy", "its topic")
    timeout_s: float = bounded(0.5, 0.05, 60.0, "s", "silence after which it is lost", Change.START)
    button: int = bounded(0, 0, 255, "", "number of the button", Change.START)


@dataclass(frozen=True, slots=True)
class BumperParams:
    """A std_msgs/Bool topic; true means pressed."""

    use: Use = setting(Use.OFF, "bumper topic", Change.START)
    topic: str = topic("bumper", "its topic")
    timeout_s: float = bounded(0.5, 0.05, 60.0, "s", "silence after which it is lost", Change.START)


@dataclass(frozen=True, slots=True)
class TiltParams:
    """A sensor_msgs/Imu topic; a tilt above `max_rad` stops the robot."""

    use: Use = setting(Use.OFF, "tilt of an IMU", Change.START)
    topic: str = topic("imu", "its topic")
    timeout_s: float = bounded(0.5, 0.05, 60.0, "s", "silence after which it is lost", Change.START)
    max_rad: float = bounded(0.35, 0.01, 3.1, "rad", "largest tilt")


@dataclass(frozen=True, slots=True)
class DiagnosticsParams:
    """A diagnostic_msgs/DiagnosticArray topic; robotctl's own diagnostics do not count."""

    use: Use = setting(Use.OFF, "diagnostics of the base", Change.START)
    topic: str = topic("/diagnostics", "its topic")
    timeout_s: float = bounded(5.0, 0.05, 60.0, "s", "silence after which it is lost", Change.START)


InputParams = EstopParams | JoyParams | BumperParams | TiltParams | DiagnosticsParams


@dataclass(frozen=True, slots=True)
class SafetyInputParams:
    """The parameters of all safety inputs."""

    estop: EstopParams = field(default_factory=EstopParams)
    joy: JoyParams = field(default_factory=JoyParams)
    bumper: BumperParams = field(default_factory=BumperParams)
    tilt: TiltParams = field(default_factory=TiltParams)
    diagnostics: DiagnosticsParams = field(default_factory=DiagnosticsParams)

    def of(self, kind: SafetyInput) -> InputParams:
        """Return the parameters of the input `kind`."""
        params: InputParams = getattr(self, kind.value)
        return params


Readings = tuple[Reading | None, ...]
"""The last reading of each input, in the order of `SafetyInput`; () before the first one."""

_KINDS = tuple(SafetyInput)


def with_reading(readings: Readings, reading: Reading) -> Readings:
    """Return `readings` with the entry of one input replaced by `reading`."""
    before = readings or (None,) * len(_KINDS)
    return tuple(
        reading if kind is reading.kind else each for kind, each in zip(_KINDS, before, strict=True)
    )
