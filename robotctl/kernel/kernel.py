"""The single owner of mode and command: `Kernel.step` is total and deterministic."""

from __future__ import annotations

from dataclasses import replace
from typing import assert_never

from robotctl.kernel.battery import counts_in_percent, level_of
from robotctl.kernel.drive import MAX_LAPS, Drive, Progress
from robotctl.kernel.health import Health, Stalls
from robotctl.kernel.limits import allowed, limit, within
from robotctl.kernel.modes import REQUESTS, TRANSITIONS, Guard, Mode, Trigger
from robotctl.kernel.odometry import (
    dropped,
    is_finite,
    is_repeated,
    may_follow,
    odometry_fault,
    source_found,
)
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.safety import (
    FAULT_TRIGGERS,
    RULE_OF,
    Finding,
    failed_start_condition,
    raised,
    remedies_for,
    remedies_to_move,
    uncleared,
)
from robotctl.kernel.state import State
from robotctl.kernel.tracking import track
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    Cause,
    CommandListenersSeen,
    CommandPublishersSeen,
    DriveEnded,
    DriveRequested,
    Effect,
    Event,
    FaultCleared,
    FaultReported,
    ForeignCommandHeard,
    LatchEmergencyStop,
    LoopStalled,
    ModeChanged,
    ModeRequested,
    OdometrySourceFound,
    OdomReceived,
    Phase,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    ResetRequested,
    Tick,
)
from robotctl.kernel.units import NS_PER_S

MAX_WAITING = 64
"""How many requests may wait for a ramp to end; one more is refused."""

STOPPING_REFUSAL = "the robot is stopping: ask again when it is IDLE"

_OPERATOR_CAUSES = {
    Mode.ERROR: Cause.OPERATOR_ERROR,
    Mode.EMERGENCY_STOP: Cause.OPERATOR_STOP,
}

VALID_MODES = ", ".join(f"{mode.value} {mode.name}" for mode in Mode)


class Kernel:
    """Decides mode and command; `state` is replaced as a whole by each step."""

    def __init__(self, params: KernelParams, state: State | None = None) -> None:
        """`state` may come from a kernel with other limits."""
        self.params = params
        state = state or State()
        self.state = replace(state, command=allowed(state.command, params.limits))
        self._effects: list[Effect] = []

    def step(self, event: Event) -> tuple[Effect, ...]:
        """Take one event and return what must be done, in order."""
        self._effects = []
        match event:
            case Tick():
                self._tick(event)
            case OdomReceived():
                self._odometry(event)
            case OdometrySourceFound():
                sources = source_found(self.state.health.odometry_sources, event)
                self._learn(event.t_ns, odometry_sources=sources)
            case BatteryReceived():
                self._battery(event)
            case ModeRequested():
                self._request(event)
            case ResetRequested():
                self._reset(event)
            case DriveRequested():
                self._request_drive(event)
            case CommandPublishersSeen():
                self._learn(event.t_ns, foreign_publishers=event.names)
            case ForeignCommandHeard():
                topic = self.state.health.command_topic
                topic = replace(topic, foreign_t_ns=event.t_ns, foreign_by=event.publisher)
                self._learn(event.t_ns, command_topic=topic)
            case CommandListenersSeen():
                topic = self.state.health.command_topic
                topic = replace(topic, listeners=event.count, other_types=event.other_types)
                self._learn(event.t_ns, command_topic=topic)
            case LoopStalled():
                self._stalled(event)
            case FaultReported():
                others = self._reported_without(event.cause)
                self._learn(event.t_ns, reported=(*others, (event.cause, event.detail)))
            case FaultCleared():
                self._learn(event.t_ns, reported=self._reported_without(event.cause))
            case _:
                assert_never(event)
        state = self.state
        assert state.mode is Mode.MOVING or state.command == ZERO, state
        assert within(state.command, self.params.limits), state
        return tuple(self._effects)

    # Measurements

    def _odometry(self, event: OdomReceived) -> None:
        """Take a sample that can be true; while MOVING, drop any other and count on the next."""
        self._notice_gap(event.t_ns)
        state, odometry, health = self.state, event.odometry, self.state.health
        sources = health.odometry_sources
        if event.source != sources.followed:
            if state.mode is Mode.MOVING or not may_follow(health, event, self.params.odometry):
                self._learn(event.t_ns, odometry_sources=dropped(health, event))
                return
            sources = replace(sources, followed=event.source, second=None)
        fault = odometry_fault(health, odometry, self.params.odometry)
        drive, error_m, last = state.drive, health.path_error_m, health.odometry
        if drive is not None and last is not None and not fault:
            drive = drive.measured(odometry.pose, last.pose.distance(odometry.pose))
            # A robot that ramps down leaves a reference that stands; that is no loss of tracking.
            error_m = drive.score.error_m if state.phase is Phase.DRIVING else 0.0
        unusable = fault and (state.mode is Mode.MOVING or not is_finite(odometry))
        if unusable:
            sources = replace(sources, dropped=sources.dropped + 1)
        is_news = not fault and not is_repeated(health, odometry)
        # Written out, as in `_move`: with `replace` a step would take a tenth longer.
        health = Health(
            odometry=last if unusable else odometry,
            odometry_t_ns=event.t_ns if is_news else health.odometry_t_ns,
            odometry_stamp_ns=odometry.stamp_ns,
            odometry_fault=fault,
            battery_level=health.battery_level,
            battery_t_ns=health.battery_t_ns,
            foreign_publishers=health.foreign_publishers,
            reported=health.reported,
            path_error_m=error_m,
            tick_gap_s=health.tick_gap_s,
            odometry_sources=sources,
            command_topic=health.command_topic,
            stalls=health.stalls,
            battery_in_percent=health.battery_in_percent,
        )
        self.state = State(
            mode=state.mode,
            phase=state.phase,
            reason=state.reason,
            cause=state.cause,
            command=state.command,
            tick_t_ns=state.tick_t_ns,
            health=health,
            drive=drive,
            stop_reason=state.stop_reason,
            waiting=state.waiting,
        )
        self._raise_fault(event.t_ns)

    def _battery(self, event: BatteryReceived) -> None:
        before, scale = self.state.health.battery_in_percent, self.params.battery.scale
        in_percent = counts_in_percent(event.level, before, scale)
        self._learn(
            event.t_ns,
            battery_level=level_of(event.level, in_percent),
            battery_t_ns=event.t_ns,
            battery_in_percent=in_percent,
        )

    def _stalled(self, event: LoopStalled) -> None:
        """Go on from the zeros that the watchdog has sent; stop where they were too many."""
        state, limit_s = self.state, self.params.max_tick_gap_s
        stalls = Stalls(state.health.stalls.count + 1, event.t_ns, event.stalled_s, event.detail)
        drive = None if state.drive is None else state.drive.from_standstill()
        health = replace(state.health, stalls=stalls)
        self.state = replace(state, command=ZERO, tick_t_ns=event.t_ns, health=health, drive=drive)
        if state.mode is Mode.MOVING and not event.stalled_s <= limit_s:
            detail = f"the control loop stalled for {event.stalled_s:.2f} s ({event.detail})"
            self._stop_for(Finding(RULE_OF[Cause.LOOP_STALLED], detail))

    def _learn(self, t_ns: int, **changes: object) -> None:
        self._notice_gap(t_ns)
        self.state = replace(self.state, health=replace(self.state.health, **changes))  # type: ignore[arg-type]
        self._raise_fault(t_ns)

    def _reported_without(self, cause: Cause) -> tuple[tuple[Cause, str], ...]:
        return tuple(entry for entry in self.state.health.reported if entry[0] is not cause)

    # The tick

    def _tick(self, event: Tick) -> None:
        self._notice_gap(event.t_ns)
        state, params = self.state, self.params
        finding = raised(state.mode, state.health, params, event.t_ns)
        if state.mode is Mode.MOVING and finding is None:
            gap_s = self._tick_gap_s(event.t_ns)
            self._move(event.t_ns, min(max(gap_s, 0.0), 2.0 / params.rate_hz))
            return
        self.state = replace(state, tick_t_ns=event.t_ns)
        if finding is None:
            self._effects.append(PublishTwist(ZERO))
        else:
            self._stop_for(finding)

    def _tick_gap_s(self, t_ns: int) -> float:
        tick_t_ns = self.state.tick_t_ns
        return 0.0 if tick_t_ns is None else (t_ns - tick_t_ns) / NS_PER_S

    def _notice_gap(self, t_ns: int) -> None:
        """Whatever is learned first after a gap shows it: all else that is stale is its fruit."""
        gap_s, health = self._tick_gap_s(t_ns), self.state.health
        late_s = gap_s if abs(gap_s) > self.params.max_tick_gap_s else 0.0
        if late_s != health.tick_gap_s:
            self.state = replace(self.state, health=replace(health, tick_gap_s=late_s))

    def _move(self, t_ns: int, dt_s: float) -> None:
        state, params, health = self.state, self.params, self.state.health
        drive, odometry = state.drive, health.odometry
        phase, stop_reason, target = state.phase, state.stop_reason, ZERO
        if phase is Phase.DRIVING and drive is not None and odometry is not None:
            drive = drive.advance(dt_s, odometry.pose, params.limits)
            if drive.finished:
                phase = Phase.STOPPING
                stop_reason = f"drive finished: {drive.laps} lap{'' if drive.laps == 1 else 's'}"
            else:
                target = track(drive.reference(), odometry.pose, params.tracking, params.limits)
        command = limit(state.command, target, dt_s, params.limits)
        self.state = State(
            mode=state.mode,
            phase=phase,
            reason=state.reason,
            cause=state.cause,
            command=command,
            tick_t_ns=t_ns,
            health=health,
            drive=drive,
            stop_reason=stop_reason,
            waiting=state.waiting,
        )
        if phase is Phase.STOPPING and command == ZERO:
            self._stand(Trigger.STANDSTILL, stop_reason, None)
        else:
            self._effects.append(PublishTwist(command))

    # Requests

    def _request(self, event: ModeRequested) -> None:
        try:
            requested = Mode(event.requested)
        except ValueError:
            self._refuse(event.request_id, f"{event.requested} is not a mode: use {VALID_MODES}")
            return
        reason = f"requested by {event.source}"
        self._decide(event.t_ns, event.request_id, REQUESTS[requested], reason)

    def _reset(self, event: ResetRequested) -> None:
        self._decide(event.t_ns, event.request_id, Trigger.RESET, f"reset by {event.source}")

    def _decide(self, t_ns: int, request_id: int, trigger: Trigger, reason: str) -> None:
        """Do what the table has for this request."""
        mode = self.state.mode
        transition = TRANSITIONS[mode, trigger]
        match transition.guard:
            case Guard.NEVER:
                self._refuse_here(request_id, trigger)
            case Guard.CAUSE_GONE:
                self._release(t_ns, request_id, trigger, reason)
            case Guard.RAMP_DOWN:
                self._ramp_down(request_id, reason)
            case Guard.START_CONDITIONS:
                self._start(t_ns, request_id, self.params.pattern, 0, reason)
            case Guard.NONE if transition.target is not mode:
                self._stand(trigger, reason, _OPERATOR_CAUSES.get(transition.target))
                self._accept(request_id, f"Mode changed to {transition.target.name}")
            case Guard.NONE:
                self._stay(request_id, trigger)

    def _stay(self, request_id: int, trigger: Trigger) -> None:
        state = self.state
        if state.phase is Phase.STOPPING:
            self._refuse(request_id, STOPPING_REFUSAL)
            return
        if state.mode is not Mode.MOVING:
            self._effects.append(PublishTwist(ZERO))
        if trigger is Trigger.RESET:
            self._accept(request_id, f"Nothing to reset: mode is {state.mode.name}")
        else:
            self._accept(request_id, f"Mode is already {state.mode.name}")

    def _request_drive(self, event: DriveRequested) -> None:
        state = self.state
        refusal = event.pattern.refusal() or _laps_refusal(event.laps)
        remedies: tuple[Remedy, ...] = ()
        if not refusal:
            if TRANSITIONS[state.mode, Trigger.REQUEST_MOVING].guard is Guard.NEVER:
                self._refuse_here(event.request_id, Trigger.REQUEST_MOVING)
                return
            if state.phase is Phase.STOPPING:
                refusal = STOPPING_REFUSAL
            elif state.mode is Mode.MOVING and not event.replace:
                refusal, remedies = "the robot is MOVING", (Remedy.STOP_OR_REPLACE,)
        if refusal:
            self._refuse(event.request_id, refusal, remedies)
            return
        reason = f"requested by {event.source}"
        self._start(event.t_ns, event.request_id, event.pattern, event.laps, reason)

    def _start(self, t_ns: int, request_id: int, pattern: Pattern, laps: int, reason: str) -> None:
        self._notice_gap(t_ns)
        finding = failed_start_condition(self.state.health, self.params, t_ns)
        if finding is not None:
            self._refuse(request_id, finding.detail, finding.remedies)
            return
        odometry = self.state.health.odometry
        assert odometry is not None, "a rule refuses to start without odometry"
        self._end_drive("replaced by another drive")
        previous, command = self.state.mode, self.state.command
        # A drive that replaces another begins at the speed that the robot has.
        progress = Progress(speed=max(command.linear, 0.0))
        self.state = replace(
            self.state,
            mode=Mode.MOVING,
            phase=Phase.DRIVING,
            reason=reason,
            drive=Drive(request_id, pattern, laps, odometry.pose, progress),
        )
        if previous is not Mode.MOVING:
            self._effects.append(ModeChanged(previous, Mode.MOVING, reason))
            self._accept(request_id, "Mode changed to MOVING")
        else:
            self._accept(request_id, "Drive replaced: mode is MOVING")

    def _ramp_down(self, request_id: int, reason: str) -> None:
        state = self.state
        if len(state.waiting) >= MAX_WAITING:
            self._refuse(request_id, "too many requests wait for the stop already")
            return
        self.state = replace(
            state,
            phase=Phase.STOPPING,
            stop_reason=state.stop_reason or reason,
            waiting=(*state.waiting, request_id),
        )

    def _release(self, t_ns: int, request_id: int, trigger: Trigger, reason: str) -> None:
        state = self.state
        cause = state.cause
        finding = None if cause is None else uncleared(cause, state.health, self.params, t_ns)
        # Not released either is what a second fault would stop again in the same moment.
        finding = finding or raised(Mode.IDLE, state.health, self.params, t_ns)
        if finding is not None:
            refusal = f"the cause of {state.mode.name} is not gone: {finding.detail}"
            self._refuse(request_id, refusal, finding.remedies)
            return
        released = state.mode
        self._stand(trigger, reason, None)
        if trigger is Trigger.RESET:
            verb = "released" if released is Mode.EMERGENCY_STOP else "cleared"
            self._accept(request_id, f"{released.name} {verb}: mode changed to IDLE")
        else:
            self._accept(request_id, "Mode changed to IDLE")

    def _refuse_here(self, request_id: int, trigger: Trigger) -> None:
        """Refuse what the table of modes does not allow in this mode."""
        state = self.state
        if state.mode is Mode.MOVING:
            self._refuse(request_id, "the robot is MOVING", (Remedy.STOP_FIRST,))
            return
        asked = trigger.value.removeprefix("request ")
        refusal = f"{asked} is refused in {state.mode.name} ({state.reason})"
        self._refuse(request_id, refusal, remedies_to_move(state.cause or Cause.OPERATOR_STOP))

    # What changes the mode

    def _raise_fault(self, t_ns: int) -> None:
        finding = raised(self.state.mode, self.state.health, self.params, t_ns)
        if finding is not None:
            self._stop_for(finding)

    def _stop_for(self, finding: Finding) -> None:
        self._stand(FAULT_TRIGGERS[finding.rule.action], finding.detail, finding.cause)

    def _stand(self, trigger: Trigger, reason: str, cause: Cause | None) -> None:
        """Go where `trigger` leads, with the command exactly zero, and say so."""
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
        self._effects.append(
            DriveEnded(state.drive.request_id, completed, reason, state.drive.report(), cause)
        )
        health = replace(state.health, path_error_m=0.0)
        self.state = replace(state, drive=None, health=health, stop_reason="")

    def _accept(self, request_id: int, message: str) -> None:
        self._effects.append(Reply(request_id, True, message, self.state.mode))

    def _refuse(self, request_id: int, message: str, remedies: tuple[Remedy, ...] = ()) -> None:
        self._effects.append(Reply(request_id, False, message, self.state.mode, remedies))


def _laps_refusal(laps: int) -> str:
    if 0 <= laps <= MAX_LAPS:
        return ""
    return f"{laps} laps: use 0 (until stopped) to {MAX_LAPS}"
