"""The driven path, with a limited number of poses, and its errors, also those of the simulator."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite, pi
from typing import Any

import pytest

from robotctl.daemon.api.warnings import of_robot
from robotctl.daemon.control import robot_report
from robotctl.daemon.control.robot_report import MIN_STEP_M, GroundTruth, RobotReport, TrueErrors
from robotctl.kernel.course import PLAIN, Course, Held
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import (
    ZERO,
    DriveEnded,
    DriveReport,
    Odometry,
    OdomReceived,
    PublishTwist,
)
from robotctl.sim import Robot, SimParams
from robotctl.testing.kernels import Bench, moving, ready, while_moving


def of(bench: Bench) -> RobotReport:
    control: Any = bench  # only its `state` is read
    return RobotReport(control)


@pytest.fixture
def bench() -> Bench:
    """A kernel that moves, without ticks so far, with the parameters that a report reads."""
    made = moving(ticks=0)
    made.params = made.kernel.params  # type: ignore[attr-defined]
    return made


def test_a_robot_that_stands_leaves_one_point() -> None:
    seen = of(moving())
    for _ in range(100):
        seen.drove_to(Pose(MIN_STEP_M / 2.0, 0.0, 0.0))
    assert seen.path()["driven"] == [[0.0, 0.0]]
    seen.drove_to(Pose(MIN_STEP_M, 0.0, 0.0))
    assert seen.path()["driven"] == [[0.0, 0.0], [MIN_STEP_M, 0.0]]


def test_of_a_long_way_every_second_point_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot_report, "MAX_DRIVEN_POSES", 10)
    seen = of(moving())
    for number in range(1, 101):
        seen.drove_to(Pose(float(number), 0.0, 0.0))
    driven = seen.path()["driven"]
    assert len(driven) <= 10
    assert (driven[0], driven[-1]) == ([0.0, 0.0], [100.0, 0.0])


def test_the_closure_is_told_from_the_end_of_the_first_lap_on(bench: Bench) -> None:
    bench.drive(Pattern(PatternKind.CIRCLE, 0.1), replacing=True)
    seen = of(bench)
    closures = []
    for _ in range(400):
        assert bench.state.drive is not None
        bench.odometry(bench.state.drive.reference().pose)
        bench.battery(1.0)
        bench.tick()
        facts = seen.facts()["drive"]
        assert facts is not None
        closures.append((facts["lap"], facts["closure_m"], facts["true_closure_m"]))
    assert {closure for lap, closure, _ in closures if lap == 1} == {None}
    later = [closure for lap, closure, _ in closures if lap > 1]
    assert later
    assert all(closure is not None and closure <= 0.02 for closure in later)
    assert {true for _, _, true in closures} == {None}


ERRORS = ("cross_track_rms_m", "cross_track_max_m", "heading_rms_rad", "heading_max_rad")


@pytest.mark.parametrize("has_path", [True, False])
def test_errors_are_told_of_a_drive_that_has_a_path(bench: Bench, has_path: bool) -> None:
    course = PLAIN if has_path else Course(held=Held(0.2, 0.1, 5.0))
    bench.drive(Pattern(PatternKind.CIRCLE, 0.5), replacing=True, course=course)
    seen = of(bench)
    for _ in range(20):
        bench.odometry(ORIGIN)
        seen.drove_to(ORIGIN)
        bench.tick()
    facts: Any = seen.facts()["drive"]
    told = [facts["cross_track_m"], *(facts[name] for name in ERRORS)]
    assert [each is not None for each in told] == [has_path] * 5
    bench.request(Mode.EMERGENCY_STOP)
    *_, ended = (each for each in bench.effects if isinstance(each, DriveEnded))
    assert ended.report.cross_track_rms_m >= 0.0  # what is journaled, as by earlier versions
    report = seen.drive_ended(ended).report
    assert [isfinite(getattr(report, name)) for name in ERRORS] == [has_path] * 4
    assert report.duration_s == ended.report.duration_s


def test_the_true_closure_is_that_of_the_moment_at_which_the_last_lap_ends(bench: Bench) -> None:
    seen = of(bench)
    seen.ground_truth.truth = lambda: ORIGIN  # the robot stands: it misses the end by the line
    bench.drive(Pattern(PatternKind.LINE, 0.2), 1, replacing=True, course=Course(open_loop=True))
    for _ in while_moving(bench):
        bench.odometry(ORIGIN)
        seen.drove_to(ORIGIN)
        bench.battery(1.0)
        bench.tick()
    *_, ended = (each for each in bench.effects if isinstance(each, DriveEnded))
    assert ended.completed
    seen.drive_ended(ended)
    true = seen.ground_truth.errors(ended.request_id)
    assert true is not None
    assert true.closure_m == pytest.approx(0.2)


@pytest.mark.parametrize(("level", "is_told"), [(0.31, False), (0.29, True)])
def test_a_battery_below_30_percent_is_a_warning(bench: Bench, level: float, is_told: bool) -> None:
    bench.battery(level)
    control: Any = bench
    told = [text for text in of_robot(control) if "charge it soon" in text]
    assert bool(told) is is_told


EXACT = SimParams(odometry_linear_factor=1.0, odometry_angular_factor=1.0, odometry_noise=0.0)
PERIOD_S = 0.02
CIRCLE, ARC = Pattern(PatternKind.CIRCLE, 0.5), Pattern(PatternKind.ARC, 0.5)


def driven(
    sim: SimParams, moved: Pose = ORIGIN, course: Course = PLAIN, pattern: Pattern = CIRCLE
) -> tuple[DriveReport, TrueErrors | None]:
    """Drive a lap; return its report, and its errors in a world that is `moved`."""
    bench, robot, truth = ready(), Robot(sim), GroundTruth()
    report: DriveReport | None = None
    truth.truth = lambda: moved.compose(robot.truth)
    bench.drive(pattern, laps=1, course=course)
    drive = bench.state.drive
    assert drive is not None
    while bench.state.drive is not None:
        drive = bench.state.drive
        robot.advance(PERIOD_S)
        measured = Odometry(robot.odometry, ZERO, bench.t_ns)
        bench.give(OdomReceived(bench.t_ns, measured))
        truth.follow(bench.state.drive, robot.odometry)
        bench.battery(1.0)
        for effect in bench.tick():
            if isinstance(effect, PublishTwist):
                robot.command(effect.twist)
            elif isinstance(effect, DriveEnded):
                truth.end(effect)
                report = effect.report
    assert truth.errors(drive.request_id + 1) is None
    assert report is not None
    return report, truth.errors(drive.request_id)


@pytest.mark.parametrize("moved", [Pose(), Pose(3.0, -2.0, 2.5), Pose(0.0, 0.0, pi)])
@pytest.mark.parametrize("course", [Course(), Course(reverse=True), Course(open_loop=True)])
@pytest.mark.parametrize("pattern", [CIRCLE, ARC])
def test_with_exact_odometry_the_true_errors_are_those_of_odometry(
    moved: Pose, course: Course, pattern: Pattern
) -> None:
    report, true = driven(EXACT, moved, course, pattern)
    assert true is not None
    errors = [getattr(report, name) for name in (*ERRORS, "closure_m")]
    assert list(true) == pytest.approx(errors, rel=0.02, abs=5e-4)


def test_what_odometry_does_not_see_is_told() -> None:
    report, true = driven(replace(EXACT, odometry_linear_factor=1.1))
    assert true is not None
    assert true.cross_track_max_m > 3.0 * report.cross_track_max_m
    assert true.cross_track_max_m > 0.03


def test_without_a_true_pose_or_a_path_there_are_no_true_errors() -> None:
    held = Course(held=Held(0.1, 0.0, 1.0))
    for true_pose, course in ((None, PLAIN), (Pose, held)):
        bench, truth = ready(), GroundTruth()
        truth.truth = true_pose or truth.truth
        bench.drive(course=course)
        assert bench.state.drive is not None
        truth.follow(bench.state.drive, Pose())
        assert truth.errors(bench.state.drive.request_id) is None
