"""The modes of the robot and the one table of transitions between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, IntEnum
from types import MappingProxyType


class Mode(IntEnum):
    """The mode of the robot; the numbers are those of robot_controller/msg/RobotStatus."""

    IDLE = 0
    MOVING = 1
    ERROR = 2
    EMERGENCY_STOP = 3


class Trigger(Enum):
    """A reason to change the mode."""

    REQUEST_IDLE = "request idle"
    REQUEST_MOVING = "request moving"
    REQUEST_ERROR = "request error"
    REQUEST_EMERGENCY_STOP = "request emergency stop"
    RESET = "reset"
    FAULT_ERROR = "fault that stops"
    FAULT_EMERGENCY_STOP = "fault that latches"
    STANDSTILL = "command ramped down to zero"


class Guard(Enum):
    """The condition of a transition."""

    NONE = "always"
    START_CONDITIONS = "every start condition holds"
    CAUSE_GONE = "the cause is gone"
    RAMP_DOWN = "after ramping down"
    NEVER = "refused"


@dataclass(frozen=True, slots=True)
class Transition:
    """The mode after a trigger that `guard` allows; Guard.NEVER refuses the trigger."""

    target: Mode
    guard: Guard = Guard.NONE


def _table() -> dict[tuple[Mode, Trigger], Transition]:
    idle, moving, error, stop = Mode.IDLE, Mode.MOVING, Mode.ERROR, Mode.EMERGENCY_STOP
    go, start = Transition, Guard.START_CONDITIONS
    gone, ramp, never = Guard.CAUSE_GONE, Guard.RAMP_DOWN, Guard.NEVER
    rows = {  # columns: IDLE, MOVING, ERROR, EMERGENCY_STOP
        Trigger.REQUEST_IDLE: (go(idle), go(idle, ramp), go(idle, gone), go(idle, gone)),
        Trigger.REQUEST_MOVING: (go(moving, start), go(moving), go(error, never), go(stop, never)),
        Trigger.REQUEST_ERROR: (go(error), go(error), go(error), go(stop, never)),
        Trigger.REQUEST_EMERGENCY_STOP: (go(stop), go(stop), go(stop), go(stop)),
        Trigger.RESET: (go(idle), go(moving, never), go(idle, gone), go(idle, gone)),
        Trigger.FAULT_ERROR: (go(error), go(error), go(error), go(stop)),
        Trigger.FAULT_EMERGENCY_STOP: (go(stop), go(stop), go(stop), go(stop)),
        Trigger.STANDSTILL: (go(idle), go(idle), go(error), go(stop)),
    }
    return {(mode, trigger): row[mode] for trigger, row in rows.items() for mode in Mode}


TRANSITIONS: Mapping[tuple[Mode, Trigger], Transition] = MappingProxyType(_table())

REQUESTS: Mapping[Mode, Trigger] = MappingProxyType(
    {
        Mode.IDLE: Trigger.REQUEST_IDLE,
        Mode.MOVING: Trigger.REQUEST_MOVING,
        Mode.ERROR: Trigger.REQUEST_ERROR,
        Mode.EMERGENCY_STOP: Trigger.REQUEST_EMERGENCY_STOP,
    }
)
