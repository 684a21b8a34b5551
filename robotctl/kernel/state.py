"""The memory of the kernel between two events."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.drive import Drive
from robotctl.kernel.guard import Guarded
from robotctl.kernel.health import UNKNOWN, Health
from robotctl.kernel.lease import Lease
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ZERO, Cause, Phase, Twist


@dataclass(frozen=True)
class State:
    """The whole memory of the kernel: state, parameters and events determine every later effect.

    `reason` says why the mode changed last; `cause` is why the mode is ERROR or EMERGENCY_STOP.
    `stop_reason` is why the robot ramps down, and `waiting` are the ids of the requests for IDLE
    that are answered at the end of the ramp. `tick_t_ns` is the time of the last tick, and
    `idle_t_ns` that of the first tick since the mode is IDLE. While `silent`, no command is sent.
    `lease` names who alone may start motion, None if everybody may.
    `guarded` holds the motion that another node steers.
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
    """Return the state of a robot whose emergency stop was not released before a restart."""
    return State(mode=Mode.EMERGENCY_STOP, reason=reason, cause=cause)
