"""The robot's state and drive, for `status` and `path` on the socket, and for `/robot_status`."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import replace
from math import nan, sqrt
from typing import NamedTuple

from robotctl.daemon.control.dispatcher import Control
from robotctl.ipc.advice import CONDITIONS, advice
from robotctl.ipc.answers import ConditionAnswer, DriveFacts, DrivenPath, Preflight, RobotFacts
from robotctl.kernel.codec import finite_or_none
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.drive import Drive, Score
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import named
from robotctl.kernel.safety import RULE_OF, remedies_for, start_conditions
from robotctl.kernel.state import State, is_level
from robotctl.kernel.types import Cause, DriveEnded, Remedy
from robotctl.ros.nodes.mode_service import ModeService
from robotctl.ros.nodes.publishers import CommandLock


class TrueErrors(NamedTuple):
    """A drive's errors by the simulated robot's true pose. `closure_m` is NaN until lap 1 ends."""

    cross_track_rms_m: float
    cross_track_max_m: float
    heading_rms_rad: float
    heading_max_rad: float
    closure_m: float


class GroundTruth:
    """Computes a drive's errors by the true pose; odometry's earlier drift does not count."""

    def __init__(self) -> None:
        self.truth: Callable[[], Pose | None] = lambda: None
        self._drive: Drive | None = None
        self._measured_start = Pose()
        self._true_start = Pose()
        self._score = Score()
        self._laps = 0
        self._closure_m = nan

    def follow(self, drive: Drive, measured: Pose) -> None:
        """Add the present true pose to the errors of `drive`; `measured` is the odometry's pose."""
        true = self.truth()
        if true is None or not drive.path.segments:
            return
        if self._drive is None or drive.request_id != self._drive.request_id:
            self._measured_start, self._true_start = measured, true
            self._score, self._laps, self._closure_m = Score(), 0, nan
        self._drive = drive
        pose = self._seen_from_odometry(true)
        self._score = drive.score_after(self._score, pose, 0.0)
        if drive.progress.laps != self._laps:
            self._laps = drive.progress.laps
            is_at_end = drive.finished and not drive.path.closed
            end = drive.origin.compose(drive.path.end) if is_at_end else drive.origin
            self._closure_m = end.distance(pose)

    def end(self, ended: DriveEnded) -> None:
        """Add the true closure error of the last lap, if the drive ended when that lap ended."""
        true, drive = self.truth(), self._drive
        if true is None or drive is None or drive.request_id != ended.request_id:
            return
        if ended.report.laps != self._laps:  # `follow` is not called after the last lap
            self._laps = ended.report.laps
            end = drive.origin if drive.path.closed else drive.origin.compose(drive.path.end)
            self._closure_m = end.distance(self._seen_from_odometry(true))

    def errors(self, request_id: int) -> TrueErrors | None:
        """Return the errors of the drive `request_id`, None unless it is the newest drive."""
        if self._drive is None or request_id != self._drive.request_id:
            return None
        score = self._score
        return TrueErrors(
            sqrt(score.squared_error_sum / score.samples),
            score.max_error_m,
            sqrt(score.squared_heading_sum / score.samples),
            score.max_heading_rad,
            self._closure_m,
        )

    def _seen_from_odometry(self, true: Pose) -> Pose:
        return self._measured_start.compose(self._true_start.express(true))


MAX_DRIVEN_POSES = 20_000
"""Limit on the poses of the driven path, above which every second pose is removed."""

MIN_STEP_M = 0.005
"""A pose nearer than this to the previous one is not kept."""

_EXPECTED = (
    Cause.ODOMETRY_LOST,
    Cause.BATTERY_UNKNOWN,
    Cause.COMMAND_UNHEARD,
    Cause.ESTOP_SILENT,
    Cause.INPUT_LOST,
    Cause.SCAN_LOST,
)
"""Causes of refusals that are usual until the robot and its inputs are discovered."""


def is_connected(control: Control) -> bool:
    """Return whether the last usable odometry is younger than `odometry.timeout_s`."""
    health = control.state.health
    age_s = (time.monotonic_ns() - health.odometry_t_ns) / NS_PER_S
    return health.odometry is not None and age_s <= control.params.odometry.timeout_s


class RobotReport:
    """Reports the kernel's state and the driven path."""

    def __init__(self, control: Control, ground_truth: GroundTruth | None = None) -> None:
        self.sim = False
        self.ground_truth = ground_truth or GroundTruth()
        self._control = control
        self._driven: list[Pose] = []
        self._wanted: list[Pose] = []
        self._drive_id: int | None = None
        self._measured_id: int | None = None

    def drove_to(self, pose: Pose) -> None:
        """Add a measured pose of the present drive to the driven path and the true errors."""
        drive = self._control.state.drive
        assert drive is not None
        self.ground_truth.follow(drive, pose)
        if drive.score.samples:
            self._measured_id = drive.request_id
        if drive.request_id != self._drive_id:
            self._drive_id = drive.request_id
            self._driven = [drive.origin]
            self._wanted = [drive.origin.compose(pose) for pose in drive.path.outline()]
        if self._driven[-1].distance(pose) >= MIN_STEP_M:
            self._driven.append(pose)
            if len(self._driven) > MAX_DRIVEN_POSES:
                del self._driven[1::2]

    def drive_ended(self, ended: DriveEnded) -> DriveEnded:
        """Note a drive's end, and return it with NaN for errors that were not measured."""
        self.ground_truth.end(ended)
        if ended.request_id == self._measured_id:
            return ended
        return replace(ended, report=ended.report.without_errors())

    def path(self) -> DrivenPath:
        """Return the reference points and the driven points [m, odom frame] of the newest drive."""
        return {
            "reference": [[pose.x, pose.y] for pose in self._wanted],
            "driven": [[pose.x, pose.y] for pose in self._driven],
        }

    def missing(self) -> list[str]:
        """Return a sentence for each absent input or subscriber that a start needs."""
        health, now = self._control.state.health, time.monotonic_ns()
        found = (RULE_OF[cause].check(health, self._control.params, now) for cause in _EXPECTED)
        missing = [text for text in found if text]
        if health.command_topic.listeners is None:
            missing.append("the nodes that subscribe to the velocity command are not known yet")
        return missing

    def facts(self) -> RobotFacts:
        """Return the fields of `status` about the robot."""
        state = self._control.state
        odometry = state.health.odometry
        level = state.health.battery_level
        return {
            "mode": state.mode.name,
            "phase": state.phase.value,
            "mode_reason": state.reason,
            "pose": None
            if odometry is None
            else {"x": odometry.pose.x, "y": odometry.pose.y, "theta": odometry.pose.theta},
            "velocity": None
            if odometry is None
            else {"linear": odometry.velocity.linear, "angular": odometry.velocity.angular},
            "battery": level if is_level(level) else None,
            "sim": self.sim,
            "lease": None if state.lease is None else state.lease.source,
            "stalls": state.health.stalls.count,
            "odometry_dropped": state.health.odometry_sources.dropped,
            "drive": _drive_facts(state, self.ground_truth),
        }

    def preflight(self, robot: str) -> Preflight:
        """Return each start condition, its problem if any, and a cure with commands for `robot`."""
        health, now_ns = self._control.state.health, time.monotonic_ns()
        conditions: list[ConditionAnswer] = []
        for rule, problem in start_conditions(health, self._control.params, now_ns):
            told = advice(problem, (rule.remedy,) if problem else (), robot)
            conditions.append(
                {
                    "cause": rule.cause.value,
                    "condition": CONDITIONS[rule.cause],
                    "problem": told.cause,
                    "cure": told.cure,
                }
            )
        passed = not any(each["problem"] for each in conditions)
        return {"passed": passed, "conditions": conditions}

    def remedies(self) -> tuple[Remedy, ...]:
        """Return the operator's ways out of the present mode."""
        return remedies_for(self._control.state.cause)


def _drive_facts(state: State, truth: GroundTruth) -> DriveFacts | None:
    drive, odometry = state.drive, state.health.odometry
    if drive is None or odometry is None:
        return None
    report = drive.report(state.tick_t_ns or drive.begin_t_ns)
    if not drive.score.samples:
        report = report.without_errors()
    true = truth.errors(drive.request_id)
    return {
        "what": named(drive.pattern, drive.course),
        "lap": report.laps + 1,
        "laps": drive.laps,
        "distance_m": report.distance_m,
        "duration_s": report.duration_s,
        "cross_track_m": drive.cross_track_m(odometry.pose) if drive.path.segments else None,
        "cross_track_rms_m": finite_or_none(report.cross_track_rms_m),
        "cross_track_max_m": finite_or_none(report.cross_track_max_m),
        "true_cross_track_rms_m": None if true is None else true.cross_track_rms_m,
        "true_cross_track_max_m": None if true is None else true.cross_track_max_m,
        "true_heading_rms_rad": None if true is None else true.heading_rms_rad,
        "true_heading_max_rad": None if true is None else true.heading_max_rad,
        "true_closure_m": None if true is None else finite_or_none(true.closure_m),
        "heading_rms_rad": finite_or_none(report.heading_rms_rad),
        "heading_max_rad": finite_or_none(report.heading_max_rad),
        "closure_m": finite_or_none(report.closure_m),
    }


SHOW_PERIOD_S = 1.0


class ShownStatus:
    """Publishes the robot's status, and whether its mode locks velocity commands of other nodes."""

    def __init__(self, modes: ModeService, control: Control, lock: CommandLock) -> None:
        self._lock = lock
        self._modes = modes
        self._control = control

    def show(self, mode: Mode) -> None:
        """Publish the command lock and the status: `mode`, battery level, freshness of odometry."""
        self._lock.show(mode)
        level = self._control.state.health.battery_level
        level = level if is_level(level) else nan
        self._modes.publish(mode, level, is_connected(self._control))

    async def run(self) -> None:
        """Publish the status once a second, until cancelled."""
        while True:
            self.show(self._control.state.mode)
            await asyncio.sleep(SHOW_PERIOD_S)
