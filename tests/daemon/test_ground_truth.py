"""The true errors of a simulated drive, which odometry cannot see."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import pytest

from robotctl.daemon.control.robot_report import GroundTruth, TrueErrors
from robotctl.kernel.course import PLAIN, Course, Held
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import (
    ZERO,
    DriveEnded,
    DriveReport,
    Odometry,
    OdomReceived,
    PublishTwist,
)
from robotctl.sim.robot import Robot, SimParams
from robotctl.testing.kernels import ready

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
    assert tuple(true) == pytest.approx(
        (
            report.cross_track_rms_m,
            report.cross_track_max_m,
            report.heading_rms_rad,
            report.heading_max_rad,
            report.closure_m,
        ),
        rel=0.02,
        abs=5e-4,
    )


def test_what_odometry_does_not_see_is_told() -> None:
    report, true = driven(replace(EXACT, odometry_linear_factor=1.1))
    assert true is not None
    assert true.cross_track_max_m > 3.0 * report.cross_track_max_m
    assert true.cross_track_max_m > 0.03


def test_without_a_true_pose_or_a_path_there_are_no_true_errors() -> None:
    bench, truth = ready(), GroundTruth()
    bench.drive()
    assert bench.state.drive is not None
    truth.follow(bench.state.drive, Pose())
    assert truth.errors(bench.state.drive.request_id) is None
    held, held_truth = ready(), GroundTruth()
    held_truth.truth = Pose
    held.drive(course=Course(held=Held(0.1, 0.0, 1.0)))
    assert held.state.drive is not None
    held_truth.follow(held.state.drive, Pose())
    assert held_truth.errors(held.state.drive.request_id) is None
