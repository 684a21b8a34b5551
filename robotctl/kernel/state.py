"""All that the kernel remembers between two events."""

from __future__ import annotations

from dataclasses import dataclass, field

from robotctl.kernel.drive import Drive
from robotctl.kernel.health import Health
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import ZERO, Cause, Phase, Twist


@dataclass(frozen=True, slots=True)
class State:
    """All that the kernel remembers; with KernelParams it decides every later effect.

    `cause` is why the mode is ERROR or EMERGENCY_STOP; `waiting` are the requests for IDLE that
    are answered when the ramp has ended.
    """

    mode: Mode = Mode.IDLE
    phase: Phase = Phase.STANDING
    reason: str = "started"
    cause: Cause | None = None
    command: Twist = ZERO
    tick_t_ns: int | None = None
    health: Health = field(default_factory=Health)
    drive: Drive | None = None
    stop_reason: str = ""
    waiting: tuple[int, ...] = ()


def latched(reason: str, cause: Cause = Cause.OPERATOR_STOP) -> State:
    """Return the state to start in when an earlier emergency stop was never released."""
    return State(mode=Mode.EMERGENCY_STOP, reason=reason, cause=cause)
