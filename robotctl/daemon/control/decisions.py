"""Adds requests and the kernel's decisions to the journal of decisions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import assert_never

from robotctl.decisions.journal import DecisionKind
from robotctl.decisions.log import DecisionLog
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import named
from robotctl.kernel.types import (
    DriveEnded,
    DriveRequested,
    Effect,
    LatchEmergencyStop,
    LeaseRequested,
    ModeChanged,
    ModeRequested,
    ParameterChanged,
    ParameterRequested,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    ResetRequested,
)

Request = ModeRequested | ResetRequested | DriveRequested | ParameterRequested | LeaseRequested


class Decisions:
    """Logs changes of mode and parameters, and requests that were refused or had an effect."""

    def __init__(
        self, log: DecisionLog, show: Callable[[Mapping[str, str]], None] = lambda change: None
    ) -> None:
        """`show(change)` is called for each change of the mode."""
        self._log = log
        self._show = show
        self._open: dict[int, tuple[Request, int]] = {}
        """Unanswered requests by id, each with the value of `_changes` before it."""
        self._changes = 0
        self._latch: dict[str, bool] = {}
        """{"latched": True} or {"released": True}, for the log entry of the next mode change."""

    def asked(self, request: Request) -> None:
        """Note a request before the kernel decides on it."""
        self._open[request.request_id] = request, self._changes

    def decided(self, effect: Effect) -> None:
        """Log an effect of the kernel other than a velocity command."""
        match effect:
            case LatchEmergencyStop():
                self._latch = {"latched": True}
            case ReleaseEmergencyStop():
                self._latch = {"released": True}
            case ModeChanged():
                self._changes += 1
                change = {
                    "from": effect.previous.name,
                    "to": effect.mode.name,
                    "reason": effect.reason,
                }
                if effect.cause is not None:
                    change["cause"] = effect.cause.value
                self._log.add_values(DecisionKind.MODE, {**change, **self._latch})
                self._latch = {}
                self._show({"event": "mode", **change})
            case DriveEnded():
                self._changes += 1
            case ParameterChanged():
                self._log.add_values(
                    DecisionKind.PARAMETER,
                    {
                        "key": effect.key,
                        "from": effect.old,
                        "to": effect.new,
                        "by": effect.source,
                    },
                )
            case Reply():
                self._answered(effect)
            case PublishTwist():
                pass  # these are in the recording, and too many for the journal
            case _:
                assert_never(effect)

    def _answered(self, reply: Reply) -> None:
        request, before = self._open.pop(reply.request_id, (None, 0))
        if request is None:
            return
        changed = self._changes > before or isinstance(request, DriveRequested | LeaseRequested)
        if changed or not reply.ok:
            reason = "" if isinstance(request, ParameterRequested) else request.reason
            self._log.add(
                DecisionKind.REQUEST if reply.ok else DecisionKind.REFUSED,
                asked=_asked(request),
                by=request.source,
                answer=reply.message,
                **({"because": reason} if reason else {}),
            )


def _asked(request: Request) -> str:
    match request:
        case ModeRequested():
            number = request.requested
            return Mode(number).name if number in list(Mode) else f"mode {number}"
        case ResetRequested():
            return "reset"
        case DriveRequested():
            return f"drive {named(request.pattern, request.course)}"
        case LeaseRequested():
            return "take the lease" if request.take else "release the lease"
        case ParameterRequested():
            return f"{request.key} = {request.new}"
