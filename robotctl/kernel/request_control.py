"""The part of the kernel that decides on requests; each request gets exactly one reply."""

from __future__ import annotations

from dataclasses import replace

from robotctl.kernel.course import PLAIN, Course, Frame
from robotctl.kernel.drive import MAX_LAPS, Drive, origin_of
from robotctl.kernel.guard import Guarded
from robotctl.kernel.lease_control import LeaseControl
from robotctl.kernel.modes import REQUESTS, TRANSITIONS, Guard, Mode, Trigger
from robotctl.kernel.patterns import SHAPES, Pattern
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.routes import path_for
from robotctl.kernel.safety import failed_start_condition, raised, remedies_to_move, uncleared
from robotctl.kernel.types import (
    ZERO,
    Cause,
    DriveRequested,
    ModeChanged,
    ModeRequested,
    Phase,
    PublishTwist,
    ResetRequested,
)
from robotctl.kernel.waypoints import local_points

MAX_WAITING = 64
"""The largest number of requests that wait for a ramp to end; one more is refused."""

STOPPING_REFUSAL = "the robot is stopping: ask again when it is IDLE"

_OPERATOR_CAUSES = {
    Mode.ERROR: Cause.OPERATOR_ERROR,
    Mode.EMERGENCY_STOP: Cause.OPERATOR_STOP,
}

VALID_MODES = ", ".join(f"{mode.value} {mode.name}" for mode in Mode)


class RequestControl(LeaseControl):
    """The decisions on requests for a mode, a reset or a drive."""

    def _request(self, event: ModeRequested) -> None:
        try:
            requested = Mode(event.requested)
        except ValueError:
            self._refuse(event.request_id, f"{event.requested} is not a mode: use {VALID_MODES}")
            return
        if requested is Mode.MOVING and self._may_not_move(event):
            return
        self._decide(event.t_ns, event.request_id, REQUESTS[requested], _told("requested", event))

    def _reset(self, event: ResetRequested) -> None:
        self._decide(event.t_ns, event.request_id, Trigger.RESET, _told("reset", event))

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
        """Refuse motion that another host or another than the holder of the lease asks for."""
        if event.remote and not self.params.remote_motion:
            refusal = f"{event.source} was called from another host, or may have been"
            self._refuse(event.request_id, refusal, (Remedy.ASK_HERE,))
            return True
        return self._is_kept_by_another(event)

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
        self,
        t_ns: int,
        request_id: int,
        pattern: Pattern,
        course: Course,
        laps: int,
        reason: str,
    ) -> None:
        self._notice_gap(t_ns)
        finding = failed_start_condition(self.state.health, self.params, t_ns)
        if finding is not None:
            self._refuse(request_id, finding.detail, finding.remedies)
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

    def _set_moving(self, reason: str, drive: Drive | None, guarded: Guarded | None) -> None:
        """Begin a motion; the fence stands around the place of the first one."""
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
        """Change to MOVING with the velocities that another node wants."""
        self._notice_gap(t_ns)
        finding = failed_start_condition(self.state.health, self.params, t_ns)
        if finding is not None:
            self._refuse(request_id, finding.detail, finding.remedies)
        else:
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
        """Refuse a request that the table of transitions forbids in this mode."""
        state = self.state
        if state.mode is Mode.MOVING:
            self._refuse(request_id, "the robot is MOVING", (Remedy.STOP_FIRST,))
            return
        asked = trigger.value.removeprefix("request ")
        refusal = f"{asked} is refused in {state.mode.name} ({state.reason})"
        self._refuse(request_id, refusal, remedies_to_move(state.cause or Cause.OPERATOR_STOP))


def _told(what: str, event: ModeRequested | ResetRequested | DriveRequested) -> str:
    """Return who asked, and why."""
    by = f"{what} by {event.source}"
    return f"{by}: {event.reason}" if event.reason else by


def _laps_refusal(laps: int) -> str:
    if 0 <= laps <= MAX_LAPS:
        return ""
    return f"{laps} laps: use 0 (until stopped) to {MAX_LAPS}"
