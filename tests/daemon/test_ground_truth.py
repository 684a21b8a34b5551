"""The true errors of a simulated drive, which odometry cannot see."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import pytest

from robotctl.daemon.control.ground_truth import GroundTruth, TrueErrors
from robotctl.kernel.course import PLAIN, Course, Held
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import ZERO, DriveReport, Odometry, OdomReceived, PublishTwist
from robotctl.sim.robot import Robot, SimParams
from robotctl.testing.kernels import ready

EXACT = SimParams(odometry_linear_factor=1.0, odometry_angular_factor=1.0, odometry_noise=0.0)
PERIOD_S = 0.02


def driven(
    sim: SimParams, moved: Pose = ORIGIN, course: Course = PLAIN
) -> tuple[DriveReport, TrueErrors | None]:
    """Drive a circle; return its report, and its errors in a world that is `moved`."""
    bench, robot, truth = ready(), Robot(sim), GroundTruth()
    truth.truth = lambda: moved.compose(robot.truth)
    bench.drive(Pattern(PatternKind.CIRCLE, 0.5), laps=1, course=course)
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
    assert truth.errors(drive.request_id + 1) is None
    return drive.report(bench.t_ns), truth.errors(drive.request_id)


@pytest.mark.parametrize("moved", [Pose(), Pose(3.0, -2.0, 2.5), Pose(0.0, 0.0, pi)])
@pytest.mark.parametrize("course", [Course(), Course(reverse=True)])
def test_with_exact_odometry_the_true_errors_are_those_of_odometry(
    moved: Pose, course: Course
) -> None:
    report, true = driven(EXACT, moved, course)
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
