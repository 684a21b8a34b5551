"""The kernel: the only code that decides mode and command. `Kernel.step` is deterministic."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import assert_never

from robotctl.kernel.guard import Guarded
from robotctl.kernel.health import Health
from robotctl.kernel.knowledge import Knowledge
from robotctl.kernel.lease import LeaseLost, LeaseRequested
from robotctl.kernel.lifecycle import LifecycleChanged
from robotctl.kernel.limits import limit, within
from robotctl.kernel.modes import Mode, Trigger
from robotctl.kernel.odometry import (
    dropped,
    is_finite,
    is_repeated,
    may_follow,
    odometry_fault,
    source_found,
)
from robotctl.kernel.parameter_change import ParameterRequested
from robotctl.kernel.params import WhenIdle
from robotctl.kernel.quick_init import maker
from robotctl.kernel.safety import raised
from robotctl.kernel.safety_inputs import Reading, with_reading
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    CommandListenersSeen,
    CommandPublishersSeen,
    DriveRequested,
    Effect,
    Event,
    FaultCleared,
    FaultReported,
    ForeignCommandHeard,
    GuardedCommandReceived,
    HoldReceived,
    LoopStalled,
    ModeRequested,
    OdometrySourceFound,
    OdomReceived,
    Phase,
    PublishTwist,
    ResetRequested,
    SafetyInputReceived,
    ScanReceived,
    Tick,
)
from robotctl.kernel.units import NS_PER_S

SILENT_AFTER_NS = NS_PER_S
"""So long zeros are sent in IDLE before silence, where that is configured."""


_new_state, _new_health = maker(State), maker(Health)

_IDLE, _MOVING = Mode.IDLE, Mode.MOVING
_DRIVING, _STOPPING = Phase.DRIVING, Phase.STOPPING
"""What each step compares with; Python 3.11 takes six times as long for a member of an enum."""


class Kernel(Knowledge):
    """The kernel: it decides mode and command, and each step replaces `state` as a whole."""

    def step(self, event: Event) -> tuple[Effect, ...]:
        """Decide one event: return the effects that the caller must carry out, in order."""
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
            case SafetyInputReceived():
                reading = Reading(event.kind, event.value, event.t_ns, event.detail)
                self._learn(event.t_ns, inputs=with_reading(self.state.health.inputs, reading))
            case ScanReceived():
                self._learn(event.t_ns, scan=self._looked_ahead(event.t_ns, event.sectors))
            case LifecycleChanged():
                self._learn(event.t_ns, lifecycle=event.state)
            case ModeRequested():
                self._request(event)
            case ResetRequested():
                self._reset(event)
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
                topic = self.state.health.command_topic
                topic = replace(
                    topic,
                    listeners=event.count,
                    other_types=event.other_types,
                    type_name=event.type_name,
                )
                self._learn(event.t_ns, command_topic=topic)
            case LeaseRequested():
                self._request_lease(event)
            case LeaseLost():
                self._lose_lease(event)
            case GuardedCommandReceived():
                if self.state.guarded is not None:
                    guarded = Guarded(event.twist, event.t_ns)
                    self.state = replace(self.state, guarded=guarded)
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
        assert state.mode is _MOVING or state.command == ZERO, state
        assert within(state.command, self.params.limits), state
        assert not state.silent or state.mode is _IDLE, state
        return tuple(self._effects)

    # Measurements

    def _odometry(self, event: OdomReceived) -> None:
        """Observe a sample of odometry; while MOVING, an impossible one is dropped and counted."""
        self._notice_gap(event.t_ns)
        state, odometry, health = self.state, event.odometry, self.state.health
        sources = health.odometry_sources
        if event.source != sources.followed:
            if state.mode is _MOVING or not may_follow(health, event, self.params.odometry):
                self._learn(event.t_ns, odometry_sources=dropped(health, event))
                return
            sources = replace(sources, followed=event.source, second=None)
        fault = odometry_fault(health, odometry, self.params.odometry)
        drive, error_m, last = state.drive, health.path_error_m, health.odometry
        if drive is not None and last is not None and not fault:
            drive = drive.measured(odometry.pose, last.pose.distance(odometry.pose))
            # While the robot ramps down the reference stands still: the distance is no error.
            error_m = drive.score.error_m if state.phase is _DRIVING else 0.0
        unusable = fault and (state.mode is _MOVING or not is_finite(odometry))
        if unusable:
            sources = replace(sources, dropped=sources.dropped + 1)
        is_news = not fault and not is_repeated(health, odometry)
        # Without `replace`, as in `_move`: it would make a step a tenth slower.
        health = _new_health(
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
            inputs=health.inputs,
            fence_origin=health.fence_origin,
            scan=health.scan,
            lifecycle=health.lifecycle,
        )
        self.state = _new_state(
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
            idle_t_ns=state.idle_t_ns,
            silent=state.silent,
            lease=state.lease,
            guarded=state.guarded,
        )
        self._raise_fault(event.t_ns)

    # The tick

    def _tick(self, event: Tick) -> None:
        self._notice_gap(event.t_ns)
        scan = self.state.health.scan
        if scan is not None:
            self._look_again(scan)
        state, params = self.state, self.params
        finding = raised(state.mode, state.health, params, event.t_ns)
        if state.mode is _MOVING and finding is None:
            self._move(event.t_ns, self._step_s(event.t_ns))
            return
        self.state = replace(state, tick_t_ns=event.t_ns)
        if finding is not None:
            self._stop_for(finding)
        elif not self._is_silent(event.t_ns):
            self._effects.append(PublishTwist(ZERO))

    def _is_silent(self, t_ns: int) -> bool:
        """Return whether others may command now: in IDLE, after SILENT_AFTER_NS of zeros."""
        state = self.state
        if self.params.command.when_idle is WhenIdle.ZEROS:
            return False
        if state.mode is not _IDLE or state.health.reported:
            self.state = replace(state, idle_t_ns=None, silent=False)
            return False
        idle_t_ns = t_ns if state.idle_t_ns is None else state.idle_t_ns
        silent = t_ns - idle_t_ns >= SILENT_AFTER_NS
        self.state = replace(state, idle_t_ns=idle_t_ns, silent=silent)
        return silent

    def _hold(self, event: HoldReceived) -> None:
        """Accept what the client of a hold-to-run motion wants; where it lets go, ramp at once."""
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

    def _step_s(self, t_ns: int) -> float:
        """Return for how long a command may change: since the last tick, at most two ticks."""
        return min(max(self._tick_gap_s(t_ns), 0.0), 2.0 / self.params.rate_hz)

    def _move(self, t_ns: int, dt_s: float) -> None:
        state, params, health = self.state, self.params, self.state.health
        drive, odometry = state.drive, health.odometry
        phase, stop_reason, target = state.phase, state.stop_reason, ZERO
        if phase is _DRIVING and drive is not None and odometry is not None:
            # A velocity is held by the clock: the base keeps it while ticks are missed.
            passed_s = dt_s if drive.course.held is None else self._tick_gap_s(t_ns)
            drive = drive.advance(passed_s, odometry.pose, params.limits, self._rise_ticks())
            if drive.finished:
                phase, stop_reason = _STOPPING, drive.ending()
            else:
                target = drive.command(odometry.pose, params.tracking, params.limits)
        command = limit(state.command, target, dt_s, params.limits)
        guarded = state.guarded
        if guarded is not None and phase is _DRIVING:
            wanted = guarded.wanted(t_ns, params.guard_timeout_s)
            command = ZERO if wanted is None else limit(state.command, wanted, dt_s, params.limits)
        held = None if drive is None else drive.course.held
        is_quiet = drive is not None and drive.is_quiet
        if drive is not None and held is not None:
            if is_quiet:  # the base may stand already: it must not be moved again by a ramp
                command = state.command if phase is _DRIVING else ZERO
            elif held.is_silent(t_ns, 1.0 / params.rate_hz):
                phase, stop_reason, command = _STOPPING, stop_reason or drive.ending(), ZERO
            elif held.is_let_go and command == ZERO and phase is _DRIVING:
                drive = drive.completed()
                phase, stop_reason = _STOPPING, drive.ending()
        self.state = _new_state(
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
            lease=state.lease,
            guarded=guarded,
        )
        if phase is _STOPPING and command == ZERO:
            self._stand(Trigger.STANDSTILL, stop_reason, None)
        elif not is_quiet:
            self._effects.append(PublishTwist(command))
