"""The part of the kernel that changes the mode and replies to requests."""

from __future__ import annotations

from dataclasses import replace

from robotctl.kernel.limits import allowed
from robotctl.kernel.modes import TRANSITIONS, Mode, Trigger
from robotctl.kernel.params import KernelParams
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.safety import FAULT_TRIGGERS, Finding, raised, remedies_for
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    ZERO,
    Cause,
    DriveEnded,
    Effect,
    LatchEmergencyStop,
    ModeChanged,
    Phase,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
)
from robotctl.kernel.units import NS_PER_S


class ModeControl:
    """The parameters, the state, and the effects that the present step has collected.

    Every change of the mode but the start of a drive goes through `_stand`.
    """

    def __init__(self, params: KernelParams, state: State | None = None) -> None:
        """Begin in `state`; its command is reduced to the limits of `params`."""
        self.params = params
        state = state or State()
        self.state = replace(state, command=allowed(state.command, params.limits))
        self._effects: list[Effect] = []

    def _tick_gap_s(self, t_ns: int) -> float:
        tick_t_ns = self.state.tick_t_ns
        return 0.0 if tick_t_ns is None else (t_ns - tick_t_ns) / NS_PER_S

    def _rise_ticks(self) -> int:
        """Return over how many ticks an acceleration builds up."""
        return round(self.params.limits.accel_rise_s * self.params.rate_hz) or 1

    def _notice_gap(self, t_ns: int) -> None:
        """Record a gap between ticks before anything else is checked.

        Data that became stale during the gap follows from it and must not be named as the cause.
        """
        gap_s, health = self._tick_gap_s(t_ns), self.state.health
        late_s = gap_s if abs(gap_s) > self.params.max_tick_gap_s else 0.0
        if late_s != health.tick_gap_s:
            self.state = replace(self.state, health=replace(health, tick_gap_s=late_s))

    def _raise_fault(self, t_ns: int) -> None:
        finding = raised(self.state.mode, self.state.health, self.params, t_ns)
        if finding is not None:
            self._stop_for(finding)

    def _stop_for(self, finding: Finding) -> None:
        self._stand(FAULT_TRIGGERS[finding.rule.action], finding.detail, finding.cause)

    def _stand(self, trigger: Trigger, reason: str, cause: Cause | None) -> None:
        """Make the transition of `trigger` with the command exactly zero; reply to all who wait."""
        previous = self.state.mode
        target = TRANSITIONS[previous, trigger].target
        self._effects.append(PublishTwist(ZERO))
        if target is Mode.EMERGENCY_STOP:
            self._effects.append(LatchEmergencyStop(reason, cause))
        elif previous is Mode.EMERGENCY_STOP:
            self._effects.append(ReleaseEmergencyStop())
        waiting = self.state.waiting
        completed = self.state.drive is not None and self.state.drive.finished
        self.state = replace(
            self.state,
            mode=target,
            phase=Phase.STANDING,
            reason=reason,
            cause=cause,
            command=ZERO,
            stop_reason="",
            waiting=(),
            idle_t_ns=None,
            silent=False,
            guarded=None,
        )
        self._effects.append(ModeChanged(previous, target, reason, cause))
        self._end_drive(reason, cause, completed=completed and target is Mode.IDLE)
        for request_id in waiting:
            if target is Mode.IDLE:
                self._accept(request_id, "Mode changed to IDLE")
            else:
                refusal = f"the mode became {target.name}: {reason}"
                self._refuse(request_id, refusal, remedies_for(cause))

    def _end_drive(
        self, reason: str, cause: Cause | None = None, *, completed: bool = False
    ) -> None:
        state = self.state
        if state.drive is None:
            return
        t_ns = state.drive.begin_t_ns if state.tick_t_ns is None else state.tick_t_ns
        self._effects.append(
            DriveEnded(state.drive.request_id, completed, reason, state.drive.report(t_ns), cause)
        )
        health = replace(state.health, path_error_m=0.0)
        self.state = replace(state, drive=None, health=health, stop_reason="")

    def _accept(self, request_id: int, message: str) -> None:
        self._effects.append(Reply(request_id, True, message, self.state.mode))

    def _refuse(self, request_id: int, message: str, remedies: tuple[Remedy, ...] = ()) -> None:
        self._effects.append(Reply(request_id, False, message, self.state.mode, remedies))
