"""Measurements, commands, causes and phases: what events and effects carry."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar, Protocol, TypeVar

from robotctl.kernel.geometry import Pose


@dataclass(frozen=True, slots=True)
class Twist:
    """A velocity in the robot's own frame: linear [m/s] forward, angular [rad/s] to the left."""

    linear: float = 0.0
    angular: float = 0.0


ZERO = Twist()


@dataclass(frozen=True, slots=True)
class Odometry:
    """A sample of odometry: pose in the `odom` frame, velocity in the robot's frame, stamp."""

    pose: Pose
    velocity: Twist
    stamp_ns: int


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]


T = TypeVar("T", bound=_Dataclass)


def changed(value: T, **changes: Any) -> T:
    """Return a copy of a frozen dataclass without slots, with some fields changed.

    Use it for the dataclasses that each step copies: `dataclasses.replace` is four times as slow.
    """
    fields = value.__dict__ | changes
    assert len(fields) <= len(value.__dataclass_fields__), changes  # a name that is no field
    copy = object.__new__(type(value))
    object.__setattr__(copy, "__dict__", fields)
    return copy


class Cause(Enum):
    """Why the robot may not move; `robotctl.kernel.safety` says what each cause leads to."""

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
    """What the robot is doing within its mode."""

    STANDING = "standing"
    DRIVING = "driving"
    STOPPING = "stopping"
