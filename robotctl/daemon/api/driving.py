"""Converts socket methods that drive, and goals of `drive_pattern`, into events for the kernel."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from robotctl.base.errors import Refused, UsageError
from robotctl.base.paths import DEFAULT_ROBOT
from robotctl.daemon.control.dispatcher import Control, granted
from robotctl.daemon.control.robot_report import GroundTruth, RobotReport
from robotctl.ipc.advice import advice
from robotctl.ipc.answers import DriveAnswer, DrivenPath, HoldAnswer, ModeAnswer, Preflight
from robotctl.ipc.method_names import (
    DRIVE,
    DRIVE_PATH,
    DRIVE_VELOCITY,
    END_DRIVE,
    HOLD,
    PATH,
    PREFLIGHT,
    RESET,
    SET_MODE,
)
from robotctl.ipc.method_params import (
    DriveParams,
    DrivePathParams,
    DriveVelocityParams,
    EndDriveParams,
    HoldParams,
    MotionParams,
    NoParams,
    ResetParams,
    SetModeParams,
)
from robotctl.ipc.server import Method
from robotctl.kernel.codec import finite_or_none
from robotctl.kernel.course import MAX_SILENCE_S, PLAIN, Course, Held
from robotctl.kernel.drive import MAX_LAPS
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import SHAPES, Pattern, PatternKind, SizeName
from robotctl.kernel.safety import remedies_for
from robotctl.kernel.types import (
    DriveEnded,
    DriveRequested,
    HoldReceived,
    ModeRequested,
    Phase,
    Reply,
    ResetRequested,
    Twist,
)
from robotctl.ros.nodes.drive_action import DriveProgress, Goal, GoalDrive


def default_laps(kind: PatternKind, *, wait: bool) -> int:
    """Return 0 (endless) for a closed pattern if the client does not `wait`, otherwise 1."""
    return 1 if wait or not SHAPES[kind].closed else 0


def shape_size_m(params: DriveParams) -> float | None:
    """Return the requested size [m], or None if none was requested.

    Raises:
        UsageError: The pattern has no size of the requested kind.
    """
    kind = params.pattern
    wanted = SHAPES[kind].size_name
    sizes_m = {
        SizeName.SIDE: params.side_m,
        SizeName.RADIUS: params.radius_m,
        SizeName.LENGTH: params.length_m,
    }
    for name, size_m in sizes_m.items():
        if size_m is not None and name is not wanted:
            use = f": use --{wanted.value}" if wanted else ""
            raise UsageError(f"a {kind.value} has no {name.value}{use}")
    return None if wanted is None else sizes_m[wanted]


def shape_course(params: DriveParams) -> Course:
    """Return the course of the pattern in `params`.

    Raises:
        UsageError: A corner radius or an angle was given, but the pattern has none.
    """
    shape, name = SHAPES[params.pattern], params.pattern.value
    if params.corner_m is not None and not shape.has_corner:
        raise UsageError(f"a {name} has no rounded corners")
    if params.angle_rad is not None and not shape.has_angle:
        raise UsageError(f"a {name} has no angle")
    return Course(
        corner_m=PLAIN.corner_m if params.corner_m is None else params.corner_m,
        angle_rad=PLAIN.angle_rad if params.angle_rad is None else params.angle_rad,
        reverse=params.reverse,
        open_loop=params.open_loop,
    )


MODE_DEADLINE_S = 30.0
"""Deadline of a mode request."""


class DrivingMethods:
    """The handlers of the control socket's methods that drive the robot."""

    def __init__(
        self,
        control: Control,
        robot_report: RobotReport,
        robot: str = DEFAULT_ROBOT,
        client_of: Callable[[str | None], int] = lambda token: 0,
    ) -> None:
        """`client_of(token)` returns the number of the lease's holder, 0 for any other token."""
        self._client_of = client_of
        self._robot = robot
        self._control = control
        self._robot_report = robot_report

    def table(self) -> dict[str, Method[Any]]:
        """Return the handlers of the driving methods by method name."""
        return {
            PATH: Method(NoParams, self._get_path),
            PREFLIGHT: Method(NoParams, self._preflight),
            SET_MODE: Method(SetModeParams, self._set_mode, MODE_DEADLINE_S),
            RESET: Method(ResetParams, self._reset, MODE_DEADLINE_S),
            DRIVE: Method(DriveParams, self._drive, None),
            DRIVE_VELOCITY: Method(DriveVelocityParams, self._drive_velocity, None),
            DRIVE_PATH: Method(DrivePathParams, self._drive_path, None),
            END_DRIVE: Method(EndDriveParams, self._end_drive, None),
            HOLD: Method(HoldParams, self._hold),
        }

    def pattern(
        self,
        kind: PatternKind | None,
        size_m: float | None = None,
        speed_mps: float | None = None,
    ) -> Pattern:
        """Return the pattern to drive, with configured values for arguments that are None.

        Only the configured kind has the configured size; other kinds have their own default.

        Raises:
            UsageError: The speed is above the configured limit.
        """
        self._check_speed(speed_mps)
        configured = self._control.params.pattern
        if kind is None or kind is configured.kind:
            kind, default_m = configured.kind, configured.size_m
        else:
            default_m = SHAPES[kind].default_size_m
        return Pattern(
            kind,
            default_m if size_m is None else size_m,
            configured.speed_mps if speed_mps is None else speed_mps,
        )

    async def begin(self, kind: PatternKind, source: str) -> Reply:
        """Request a drive of one lap, or endless if the pattern is closed; return the reply."""
        pattern, laps = self.pattern(kind), default_laps(kind, wait=False)
        event = DriveRequested(*self._control.stamp(), pattern, laps, False, source)
        return await self._control.request(event)

    async def _get_path(self, _: NoParams) -> DrivenPath:
        return self._robot_report.path()

    async def _preflight(self, _: NoParams) -> Preflight:
        return self._robot_report.preflight(self._robot)

    async def _set_mode(self, params: SetModeParams) -> ModeAnswer:
        if params.mode not in list(Mode):
            names = ", ".join(f"{mode.value} {mode.name}" for mode in Mode)
            raise UsageError(f"{params.mode} is not a mode", f"use {names}")
        event = ModeRequested(
            *self._control.stamp(),
            params.mode,
            params.source,
            self._client_of(params.lease),
            params.reason,
        )
        return granted(await self._control.request(event), self._robot)

    async def _reset(self, params: ResetParams) -> ModeAnswer:
        event = ResetRequested(*self._control.stamp(), params.source, params.reason)
        return granted(await self._control.request(event), self._robot)

    async def _drive(self, params: DriveParams) -> DriveAnswer:
        kind = params.pattern
        pattern = self.pattern(kind, shape_size_m(params), params.speed_mps)
        laps = default_laps(kind, wait=params.wait) if params.laps is None else params.laps
        return await self._run(params, pattern, laps, shape_course(params))

    async def _drive_path(self, params: DrivePathParams) -> DriveAnswer:
        pattern = self.pattern(None, None, params.speed_mps)
        laps = 1 if params.laps is None else params.laps
        course = Course(
            corner_m=PLAIN.corner_m if params.corner_m is None else params.corner_m,
            reverse=params.reverse,
            open_loop=params.open_loop,
            waypoints=tuple(params.points),
            frame=params.frame,
        )
        return await self._run(params, pattern, laps, course)

    async def _drive_velocity(self, params: DriveVelocityParams) -> DriveAnswer:
        limit_rps = self._control.params.limits.angular_rps
        self._check_speed(abs(params.linear_mps))
        if abs(params.angular_rps) > limit_rps:
            raise UsageError(
                f"{params.angular_rps:.12g} rad/s is above limits.angular_rps, {limit_rps:g} rad/s",
                f"use at most {limit_rps:g}",
            )
        held = Held(params.linear_mps, params.angular_rps, params.for_s, quiet_s=params.quiet_s)
        return await self._run(params, self.pattern(None), 1, Course(held=held))

    async def _run(
        self, params: MotionParams, pattern: Pattern, laps: int, course: Course
    ) -> DriveAnswer:
        """Request a drive, wait for its end if `params.wait` is set, and return the answer.

        Raises:
            Refused: The kernel refused the drive, or the drive ended early.
        """
        event = DriveRequested(
            *self._control.stamp(),
            pattern,
            laps,
            params.replace,
            params.source,
            self._client_of(params.lease),
            params.reason,
            course,
        )
        end = self._control.expect_end(event.request_id)
        try:
            answer = granted(await self._control.request(event), self._robot)
            if not params.wait:
                return {"message": answer["message"], "mode": answer["mode"]}
            ended = await end
        except asyncio.CancelledError:
            if params.wait:
                self.ramp_down(event.request_id, f"{params.source}, whose connection closed")
            raise
        finally:
            end.cancel()
        mode = self._control.state.mode
        result = _drive_answer(ended, mode, self._robot_report.ground_truth)
        if not (ended.completed if event.laps else mode is Mode.IDLE):
            text = f"the drive ended after {ended.report.laps} laps: {ended.reason}"
            remedies = remedies_for(ended.cause)
            raise Refused(*advice(text, remedies, self._robot), answer=result)
        return result

    async def _end_drive(self, params: EndDriveParams) -> ModeAnswer:
        """Ramp down if the robot moves."""
        state = self._control.state
        if state.mode is not Mode.MOVING:  # a request for IDLE would release an error or a stop
            return {"message": f"The robot stands, in {state.mode.name}", "mode": state.mode.name}
        return granted(await self._control.request(self._idle_request(params.source)), self._robot)

    async def _hold(self, params: HoldParams) -> HoldAnswer:
        """Begin a motion, or keep the motion with the number `params.hold` going."""
        if params.hold:
            return self._hold_again(params)
        now_ns, request_id = self._control.stamp()
        held = Held(params.linear_mps, params.angular_rps, MAX_SILENCE_S, now_ns)
        event = DriveRequested(
            now_ns,
            request_id,
            self._control.params.pattern,
            1,
            False,
            params.source,
            self._client_of(params.lease),
            params.reason,
            Course(held=held),
        )
        answer = granted(await self._control.request(event), self._robot)
        return {"message": answer["message"], "mode": answer["mode"], "hold": request_id}

    def _hold_again(self, params: HoldParams) -> HoldAnswer:
        wanted = Twist(params.linear_mps, params.angular_rps)
        client = self._client_of(params.lease)
        self._control.dispatch(HoldReceived(time.monotonic_ns(), params.hold, wanted, client))
        state = self._control.state
        goes_on = state.drive is not None and state.drive.request_id == params.hold
        return {
            "message": state.reason,
            "mode": state.mode.name,
            "hold": params.hold if goes_on else 0,
        }

    def begin_goal(self, goal: Goal, source: str, *, remote: bool) -> GoalDrive:
        """Request the drive of an action's goal, and return before the kernel's reply.

        `remote` means that another host may have sent the goal.

        Raises:
            ValueError: The goal has 0 laps, an unknown pattern, or a speed above the limit.
        """
        if goal.laps == 0:
            raise ValueError(f"0 laps: a goal ends by itself: use 1 to {MAX_LAPS}")
        try:
            pattern = self.pattern(_kind(goal.pattern), goal.size_m or None, goal.speed_mps or None)
        except UsageError as error:
            raise ValueError(str(error)) from None
        event = DriveRequested(
            *self._control.stamp(), pattern, goal.laps, goal.replace, source, remote=remote
        )
        ended = self._control.expect_end(event.request_id)
        return GoalDrive(
            self._control.begin(event),
            ended,
            partial(self._progress, event.request_id),
            partial(self.ramp_down, event.request_id, f"{source}, which was cancelled"),
        )

    def _progress(self, request_id: int) -> DriveProgress | None:
        state = self._control.state
        drive, odometry = state.drive, state.health.odometry
        if drive is None or drive.request_id != request_id or odometry is None:
            return None
        laps = min(drive.progress.laps, drive.laps - 1) if drive.laps else drive.progress.laps
        return DriveProgress(drive.score.distance_m, laps, drive.cross_track_m(odometry.pose))

    def ramp_down(self, request_id: int, source: str) -> bool:
        """Ramp down the drive that `request_id` began; return False if it has ended already."""
        state = self._control.state
        is_it = state.drive is not None and state.drive.request_id == request_id
        if not is_it or state.mode is not Mode.MOVING:
            return False
        if state.phase is not Phase.STOPPING:
            self._control.begin(self._idle_request(source))
        return True

    def _idle_request(self, source: str) -> ModeRequested:
        return ModeRequested(*self._control.stamp(), Mode.IDLE, source)

    def _check_speed(self, speed_mps: float | None) -> None:
        """Raise UsageError if a speed is above the configured limit."""
        limit_mps = self._control.params.limits.linear_mps
        if speed_mps is not None and speed_mps > limit_mps:
            raise UsageError(
                f"a speed of {speed_mps:.12g} m/s is above limits.linear_mps, {limit_mps:g} m/s",
                f"use at most {limit_mps:g}, or change it: robotctl param set limits.linear_mps",
            )


def _drive_answer(ended: DriveEnded, mode: Mode, truth: GroundTruth) -> DriveAnswer:
    report, true = ended.report, truth.errors(ended.request_id)
    return {
        "message": ended.reason,
        "mode": mode.name,
        "laps": report.laps,
        "distance_m": finite_or_none(report.distance_m),
        "cross_track_rms_m": finite_or_none(report.cross_track_rms_m),
        "cross_track_max_m": finite_or_none(report.cross_track_max_m),
        "true_cross_track_rms_m": None if true is None else true.cross_track_rms_m,
        "true_cross_track_max_m": None if true is None else true.cross_track_max_m,
        "true_heading_rms_rad": None if true is None else true.heading_rms_rad,
        "true_heading_max_rad": None if true is None else true.heading_max_rad,
        "true_closure_m": None if true is None else finite_or_none(true.closure_m),
        "closure_m": finite_or_none(report.closure_m),
        "heading_rms_rad": finite_or_none(report.heading_rms_rad),
        "heading_max_rad": finite_or_none(report.heading_max_rad),
        "duration_s": finite_or_none(report.duration_s),
    }


MAX_SHOWN = 40
"""How many characters of an unknown pattern's name a refusal shows."""


def _kind(name: str) -> PatternKind | None:
    try:
        return PatternKind(name) if name else None
    except ValueError:
        names = ", ".join(kind.value for kind in PatternKind)
        raise UsageError(f"no pattern {name[:MAX_SHOWN]!r}", f"use {names}") from None
