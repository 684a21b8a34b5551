"""The kernel, the only code that decides mode and command."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import assert_never

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import PLAIN, Course, Frame
from robotctl.kernel.drive import MAX_LAPS, Drive, origin_of
from robotctl.kernel.modes import REQUESTS, TRANSITIONS, Guard, Mode, Trigger
from robotctl.kernel.obstacles import look_again, look_ahead
from robotctl.kernel.odometry import source_found, with_odometry
from robotctl.kernel.parameter_keys import conflict, kernel_leaves, text_of, value_at, with_text
from robotctl.kernel.params import KernelParams, WhenIdle
from robotctl.kernel.patterns import SHAPES, Pattern, local_points
from robotctl.kernel.ranges import Change
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
from robotctl.kernel.safety_inputs import Reading, with_reading
from robotctl.kernel.speed_plan import path_for
from robotctl.kernel.state import Guarded, Stalls, State, counts_in_percent, level_of
from robotctl.kernel.tracking import allowed, limit, within
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
    GuardedCommandReceived,
    HoldReceived,
    LatchEmergencyStop,
    Lease,
    LeaseLost,
    LeaseRequested,
    LifecycleChanged,
    LoopStalled,
    ModeChanged,
    ModeRequested,
    OdometrySourceFound,
    OdomReceived,
    ParameterChanged,
    ParameterRequested,
    Phase,
    PublishTwist,
    ReleaseEmergencyStop,
    Remedy,
    Reply,
    ResetRequested,
    SafetyInputReceived,
    ScanReceived,
    Tick,
    changed,
)

SILENT_AFTER_NS = NS_PER_S
"""The time for which zeros are sent in IDLE, with `command.when_idle: silent`."""

MAX_WAITING = 64
"""The largest number of requests that wait for the end of a ramp."""

STOPPING_REFUSAL = "the robot is stopping: ask again when it is IDLE"

_OPERATOR_CAUSES = {Mode.ERROR: Cause.OPERATOR_ERROR, Mode.EMERGENCY_STOP: Cause.OPERATOR_STOP}

VALID_MODES = ", ".join(f"{mode.value} {mode.name}" for mode in Mode)


class Kernel:
    """Decides deterministically on one event at a time, with one reply to each request."""

    def __init__(self, params: KernelParams, state: State | None = None) -> None:
        """Begin in `state`, with its command clamped to the velocity limits of `params`."""
        self.params = params
        state = state or State()
        self.state = replace(state, command=allowed(state.command, params.limits))
        self._effects: list[Effect] = []

    def step(self, event: Event) -> tuple[Effect, ...]:
        """Handle one event and return its effects; the caller must carry them out in order."""
        self._effects = []
        match event:
            case Tick():
                self._tick(event.t_ns)
            case OdomReceived():
                self._notice_gap(event.t_ns)
                self.state = with_odometry(self.state, event, self.params.odometry)
                self._raise_fault(event.t_ns)
            case OdometrySourceFound():
                sources = source_found(self.state.health.odometry_sources, event)
                self._learn(event.t_ns, odometry_sources=sources)
            case BatteryReceived():
                self._battery(event)
            case SafetyInputReceived():
                reading = Reading(event.kind, event.value, event.t_ns, event.detail)
                self._learn(event.t_ns, inputs=with_reading(self.state.health.inputs, reading))
            case ScanReceived():
                scan = look_ahead(event.t_ns, event.sectors, self.state.command, self.params)
                self._learn(event.t_ns, scan=scan)
            case LifecycleChanged():
                self._learn(event.t_ns, lifecycle=event.state)
            case ModeRequested():
                self._request(event)
            case ResetRequested():
                self._decide(event.t_ns, event.request_id, Trigger.RESET, _told("reset", event))
            case DriveRequested():
                self._request_drive(event)
            case ParameterRequested():
                self._request_parameter(event)
            case CommandPublishersSeen():
                self._learn(event.t_ns, foreign_publishers=event.names)
            case ForeignCommandHeard():
                topic = self.state.health.command_topic
                topic = replace(topic, foreign_t_ns=event.t_ns, foreign_by=event.publisher)
                self._learn(event.t_ns, command_topic=topic)
            case CommandListenersSeen():
                topic = replace(
                    self.state.health.command_topic,
                    listeners=event.count,
                    other_types=event.other_types,
                    type_name=event.type_name,
                )
                self._learn(event.t_ns, command_topic=topic)
            case LeaseRequested():
                self._request_lease(event)
            case LeaseLost():
                lease = self.state.lease
                if lease is not None and lease.client == event.client:
                    self._end_lease(f"{lease.source} lost the lease: {event.how}")
            case GuardedCommandReceived():
                if self.state.guarded is not None:
                    self.state = replace(self.state, guarded=Guarded(event.twist, event.t_ns))
            case HoldReceived():
                self._hold(event)
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
        assert not state.silent or state.mode is Mode.IDLE, state
        return tuple(self._effects)

    # Health

    def _learn(self, t_ns: int, **changes: object) -> None:
        """Change fields of the health, and the mode at once after a fault."""
        self._notice_gap(t_ns)
        self.state = changed(self.state, health=changed(self.state.health, **changes))
        self._raise_fault(t_ns)

    def _notice_gap(self, t_ns: int) -> None:
        """Record a gap between ticks before its consequences, such as stale data."""
        gap_s, health = self._tick_gap_s(t_ns), self.state.health
        late_s = gap_s if abs(gap_s) > self.params.max_tick_gap_s else 0.0
        if late_s != health.tick_gap_s:
            self.state = replace(self.state, health=replace(health, tick_gap_s=late_s))

    def _battery(self, event: BatteryReceived) -> None:
        before, scale = self.state.health.battery_in_percent, self.params.battery.scale
        in_percent = counts_in_percent(event.level, before, scale)
        self._learn(
            event.t_ns,
            battery_level=level_of(event.level, in_percent),
            battery_t_ns=event.t_ns,
            battery_in_percent=in_percent,
        )

    def _reported_without(self, cause: Cause) -> tuple[tuple[Cause, str], ...]:
        return tuple(entry for entry in self.state.health.reported if entry[0] is not cause)

    def _stalled(self, event: LoopStalled) -> None:
        """Continue from the watchdog's zeros; in MOVING, a long stall is a fault."""
        state, limit_s = self.state, self.params.max_tick_gap_s
        stalls = Stalls(state.health.stalls.count + 1, event.t_ns, event.stalled_s, event.detail)
        drive = None if state.drive is None else state.drive.from_standstill()
        health = replace(state.health, stalls=stalls)
        self.state = replace(state, command=ZERO, tick_t_ns=event.t_ns, health=health, drive=drive)
        if state.mode is Mode.MOVING and not event.stalled_s <= limit_s:
            detail = f"the control loop stalled for {event.stalled_s:.2f} s ({event.detail})"
            self._stop_for(Finding(RULE_OF[Cause.LOOP_STALLED], detail))

    # The tick

    def _tick(self, t_ns: int) -> None:
        self._notice_gap(t_ns)
        scan = self.state.health.scan
        if scan is not None:  # the command may have changed
            seen = look_again(scan, self.state.command, self.params)
            if seen is not scan:
                self.state = replace(self.state, health=replace(self.state.health, scan=seen))
        state = self.state
        finding = raised(state.mode, state.health, self.params, t_ns)
        if state.mode is Mode.MOVING and finding is None:
            self._move(t_ns, self._step_s(t_ns))
            return
        self.state = changed(state, tick_t_ns=t_ns)
        if finding is not None:
            self._stop_for(finding)
        elif not self._is_silent(t_ns):
            self._effects.append(PublishTwist(ZERO))

    def _tick_gap_s(self, t_ns: int) -> float:
        tick_t_ns = self.state.tick_t_ns
        return 0.0 if tick_t_ns is None else (t_ns - tick_t_ns) / NS_PER_S

    def _step_s(self, t_ns: int) -> float:
        """Return the time since the last tick, limited to 0 to 2 periods [s]."""
        return min(max(self._tick_gap_s(t_ns), 0.0), 2.0 / self.params.rate_hz)

    def _rise_ticks(self) -> int:
        return round(self.params.limits.accel_rise_s * self.params.rate_hz) or 1

    def _is_silent(self, t_ns: int) -> bool:
        """Update and return `state.silent`."""
        state = self.state
        if self.params.command.when_idle is WhenIdle.ZEROS:
            return False
        if state.mode is not Mode.IDLE or state.health.reported:
            self.state = replace(state, idle_t_ns=None, silent=False)
            return False
        idle_t_ns = t_ns if state.idle_t_ns is None else state.idle_t_ns
        silent = t_ns - idle_t_ns >= SILENT_AFTER_NS
        self.state = replace(state, idle_t_ns=idle_t_ns, silent=silent)
        return silent

    def _move(self, t_ns: int, dt_s: float) -> None:
        """Command the next velocity of the motion; end the motion at the end of its ramp."""
        state, params = self.state, self.params
        drive, odometry, phase = state.drive, state.health.odometry, state.phase
        driving, stop_reason, target = phase is Phase.DRIVING, state.stop_reason, ZERO
        if driving and drive is not None and odometry is not None:
            # A held velocity counts the whole gap: the base keeps it while ticks are missed.
            passed_s = dt_s if drive.course.held is None else self._tick_gap_s(t_ns)
            drive = drive.advance(passed_s, odometry.pose, params.limits, self._rise_ticks())
            if drive.finished:
                phase, driving, stop_reason = Phase.STOPPING, False, drive.ending()
            else:
                target = drive.command(odometry.pose, params.tracking, params.limits)
        command = limit(state.command, target, dt_s, params.limits)
        if state.guarded is not None and driving:
            wanted = state.guarded.wanted(t_ns, params.guard_timeout_s)
            command = ZERO if wanted is None else limit(state.command, wanted, dt_s, params.limits)
        held = None if drive is None else drive.course.held
        is_quiet = False
        if drive is not None and held is not None:
            is_quiet = drive.is_quiet
            if is_quiet:  # the base may stand already: it must not be moved again by a ramp
                command = state.command if driving else ZERO
            elif held.is_silent(t_ns, 1.0 / params.rate_hz):
                phase, stop_reason, command = Phase.STOPPING, stop_reason or drive.ending(), ZERO
            elif held.is_let_go and command == ZERO and driving:
                drive = drive.completed()
                phase, stop_reason = Phase.STOPPING, drive.ending()
        self.state = changed(
            state,
            phase=phase,
            command=command,
            tick_t_ns=t_ns,
            drive=drive,
            stop_reason=stop_reason,
        )
        if phase is Phase.STOPPING and command == ZERO:
            self._stand(Trigger.STANDSTILL, stop_reason, None)
        elif not is_quiet:
            self._effects.append(PublishTwist(command))

    def _hold(self, event: HoldReceived) -> None:
        """Set the velocity of a hold-to-run client; for zero, start the ramp at once."""
        drive, lease = self.state.drive, self.state.lease
        if drive is None or drive.request_id != event.hold:
            return
        held, wanted = drive.course.held, event.twist
        is_finite = isfinite(wanted.linear) and isfinite(wanted.angular)
        if held is None or not held.is_held_to_run or not is_finite:
            return
        if lease is not None and lease.client != event.client:
            return
        self.state = replace(self.state, drive=drive.held_again(wanted, event.t_ns))
        if wanted == ZERO and not held.is_let_go:
            self._move(event.t_ns, self._step_s(event.t_ns))

    # Requests

    def _request(self, event: ModeRequested) -> None:
        try:
            requested = Mode(event.requested)
        except ValueError:
            self._refuse(event.request_id, f"{event.requested} is not a mode: use {VALID_MODES}")
            return
        if requested is Mode.MOVING and self._may_not_move(event):
            return
        self._decide(event.t_ns, event.request_id, REQUESTS[requested], _told("requested", event))

    def _decide(self, t_ns: int, request_id: int, trigger: Trigger, reason: str) -> None:
        """Decide on a request by the table of transitions."""
        mode = self.state.mode
        transition = TRANSITIONS[mode, trigger]
        match transition.guard:
            case Guard.NEVER:
                self._refuse_here(request_id, trigger)
            case Guard.CAUSE_GONE:
                self._release(t_ns, request_id, trigger, reason)
            case Guard.RAMP_DOWN:
                self._ramp_down(request_id, reason)
            case Guard.START_CONDITIONS if self.params.guard:
                self._start_guarded(t_ns, request_id, reason)
            case Guard.START_CONDITIONS:
                pattern = self.params.pattern
                laps = 0 if SHAPES[pattern.kind].closed else 1
                self._start(t_ns, request_id, pattern, PLAIN, laps, reason)
            case Guard.NONE if transition.target is not mode:
                self._stand(trigger, reason, _OPERATOR_CAUSES.get(transition.target))
                self._accept(request_id, f"Mode changed to {transition.target.name}")
            case Guard.NONE:
                self._stay(request_id, trigger)

    def _may_not_move(self, event: ModeRequested | DriveRequested) -> bool:
        """Refuse a request from another host, or against a lease; return whether it was refused."""
        if event.remote and not self.params.remote_motion:
            refusal = f"{event.source} was called from another host, or may have been"
            self._refuse(event.request_id, refusal, (Remedy.ASK_HERE,))
            return True
        lease = self.state.lease
        if lease is None or lease.client == event.client:
            return False
        self._refuse_for(lease, event)
        return True

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
        if self._may_not_move(event):
            return
        state = self.state
        refusal = event.pattern.refusal(event.course) or _laps_refusal(event.laps)
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
        reason = _told("requested", event)
        self._start(event.t_ns, event.request_id, event.pattern, event.course, event.laps, reason)

    def _start(
        self, t_ns: int, request_id: int, pattern: Pattern, course: Course, laps: int, reason: str
    ) -> None:
        if not self._may_start(t_ns, request_id):
            return
        odometry = self.state.health.odometry
        assert odometry is not None, "a rule refuses without odometry"
        if course.waypoints:
            points = local_points(course, odometry.pose)
            course = replace(course, waypoints=points, frame=Frame.START)
            if not path_for(pattern, course, laps).segments:
                self._refuse(request_id, "the robot is at each point of the path already")
                return
        replaced = self.state.drive
        if replaced is not None and replaced.is_quiet:  # the base may stand already
            self.state = replace(self.state, command=ZERO)
        self._end_drive("replaced by another drive")
        if course.held is not None:
            laps, course = 1, replace(course, held=course.held.begun(t_ns))
        previous, command = self.state.mode, self.state.command
        origin = origin_of(odometry.pose, course)
        drive = Drive(request_id, pattern, laps, origin, course=course, begin_t_ns=t_ns)
        # A drive that replaces another one begins at the present speed.
        speed_mps = -command.linear if course.reverse else command.linear
        if drive.path.segments:
            drive = drive.begin_at(
                speed_mps, self.params.limits, 1.0 / self.params.rate_hz, self._rise_ticks()
            )
        self._set_moving(reason, drive, None)
        if previous is not Mode.MOVING:
            self._effects.append(ModeChanged(previous, Mode.MOVING, reason))
            self._accept(request_id, "Mode changed to MOVING")
        else:
            self._accept(request_id, "Drive replaced: mode is MOVING")

    def _may_start(self, t_ns: int, request_id: int) -> bool:
        """Return whether every start condition holds; otherwise refuse the request."""
        self._notice_gap(t_ns)
        finding = failed_start_condition(self.state.health, self.params, t_ns)
        if finding is not None:
            self._refuse(request_id, finding.detail, (finding.rule.remedy,))
        return finding is None

    def _set_moving(self, reason: str, drive: Drive | None, guarded: Guarded | None) -> None:
        """Begin a motion; the pose at the start of the first motion becomes the fence's origin."""
        health = self.state.health
        if health.fence_origin is None and health.odometry is not None:
            health = replace(health, fence_origin=health.odometry.pose)
        self.state = replace(
            self.state,
            mode=Mode.MOVING,
            phase=Phase.DRIVING,
            reason=reason,
            health=health,
            idle_t_ns=None,
            silent=False,
            drive=drive,
            guarded=guarded,
        )

    def _start_guarded(self, t_ns: int, request_id: int, reason: str) -> None:
        """Change to MOVING with the velocities from `guard_topic`, or refuse the request."""
        if self._may_start(t_ns, request_id):
            reason = f"{reason}, guarding {self.params.guard_topic}"
            self._set_moving(reason, None, Guarded())
            self._effects.append(ModeChanged(Mode.IDLE, Mode.MOVING, reason))
            self._accept(request_id, f"Mode changed to MOVING: guarding {self.params.guard_topic}")

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
        # A second fault that would stop the robot again at once prevents the release, too.
        finding = finding or raised(Mode.IDLE, state.health, self.params, t_ns)
        if finding is not None:
            refusal = f"the cause of {state.mode.name} is not gone: {finding.detail}"
            self._refuse(request_id, refusal, (finding.rule.remedy,))
            return
        released = state.mode
        self._stand(trigger, reason, None)
        if trigger is Trigger.RESET:
            verb = "released" if released is Mode.EMERGENCY_STOP else "cleared"
            self._accept(request_id, f"{released.name} {verb}: mode changed to IDLE")
        else:
            self._accept(request_id, "Mode changed to IDLE")

    def _refuse_here(self, request_id: int, trigger: Trigger) -> None:
        """Refuse a request that the table of transitions forbids in this mode."""
        state = self.state
        if state.mode is Mode.MOVING:
            self._refuse(request_id, "the robot is MOVING", (Remedy.STOP_FIRST,))
            return
        asked = trigger.value.removeprefix("request ")
        refusal = f"{asked} is refused in {state.mode.name} ({state.reason})"
        self._refuse(request_id, refusal, remedies_to_move(state.cause or Cause.OPERATOR_STOP))

    # The lease

    def _request_lease(self, event: LeaseRequested) -> None:
        lease = self.state.lease
        if not event.take and lease is None:
            self._accept(event.request_id, "Nobody holds the lease")
        elif lease is not None and (event.take or event.client != lease.client):
            self._refuse_for(lease, event)
        elif not event.take:
            self._end_lease(f"{event.source} released the lease")
            self._accept(event.request_id, "Lease released")
        elif self.state.mode is Mode.MOVING:
            self._refuse(event.request_id, "the robot is MOVING", (Remedy.STOP_FIRST,))
        else:
            taken = Lease(event.client, event.source, event.reason)
            self.state = replace(self.state, lease=taken)
            self._accept(event.request_id, "Lease taken")

    def _end_lease(self, reason: str) -> None:
        """Remove the lease, and end a motion by a ramp."""
        state = replace(self.state, lease=None)
        if state.mode is Mode.MOVING:
            stop_reason = state.stop_reason or reason
            state = replace(state, phase=Phase.STOPPING, stop_reason=stop_reason)
        self.state = state

    def _refuse_for(
        self, lease: Lease, event: ModeRequested | DriveRequested | LeaseRequested
    ) -> None:
        why = f" ({lease.reason})" if lease.reason else ""
        refusal = f"{lease.source} holds the lease{why}, and {event.source} asked"
        self._refuse(event.request_id, refusal, (Remedy.WAIT_FOR_LEASE,))

    # Parameters

    def _request_parameter(self, event: ParameterRequested) -> None:
        leaf = kernel_leaves().get(event.key)
        change = Change.STANDING if leaf is None else leaf.declared.metadata["change"]
        if change is Change.START:
            self._refuse(event.request_id, f"{event.key} changes at a start only")
            return
        if change is Change.STANDING and self.state.mode is Mode.MOVING:
            text = f"{event.key} does not change while the robot is MOVING"
            self._refuse(event.request_id, text, (Remedy.STOP_FIRST,))
            return
        if leaf is not None:
            now = text_of(value_at(self.params, leaf.path))
            if now != event.old:
                self._refuse(event.request_id, f"{event.key} is {now}, not {event.old}")
                return
            params = self._changed_params(event)
            if params is None:
                return
            self.params = params
        if event.new != event.old:
            self._effects.append(ParameterChanged(event.key, event.old, event.new, event.source))
        self._accept(event.request_id, f"{event.key} is {event.new}")

    def _changed_params(self, event: ParameterRequested) -> KernelParams | None:
        """Return the new parameters, None after a refusal."""
        try:
            params = with_text(self.params, event.key, event.new)
        except ValueError as error:
            self._refuse(event.request_id, str(error))
            return None
        clash = conflict(params)
        if clash is not None:
            refusal = f"{clash.key}: {clash.value} is not allowed: {clash.allowed}"
            self._refuse(event.request_id, refusal)
            return None
        return params

    # The mode: only `_stand` and `_set_moving` change it

    def _raise_fault(self, t_ns: int) -> None:
        finding = raised(self.state.mode, self.state.health, self.params, t_ns)
        if finding is not None:
            self._stop_for(finding)

    def _stop_for(self, finding: Finding) -> None:
        self._stand(FAULT_TRIGGERS[finding.rule.action], finding.detail, finding.rule.cause)

    def _stand(self, trigger: Trigger, reason: str, cause: Cause | None) -> None:
        """Make the transition of `trigger`, with command zero; answer all waiting requests."""
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


def _told(what: str, event: ModeRequested | ResetRequested | DriveRequested) -> str:
    """Return a text with the request `what`, its sender and reason."""
    by = f"{what} by {event.source}"
    return f"{by}: {event.reason}" if event.reason else by


def _laps_refusal(laps: int) -> str:
    if 0 <= laps <= MAX_LAPS:
        return ""
    return f"{laps} laps: use 0 (until stopped) to {MAX_LAPS}"
