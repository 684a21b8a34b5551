"""The fence: a robot that leaves it stops, and starts again only inside."""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, nan, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.base.errors import ConfigError
from robotctl.config import Config, with_setting
from robotctl.kernel.fence import FenceParams, corners_of, is_inside, left_by
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import Cause
from robotctl.testing.kernels import Bench, ready, reset, start, stopped_by

SQUARE = "0,0 2,0 2,2 0,2"
L_SHAPE = corners_of("0,0 4,0 4,1 1,1 1,4 0,4")


def driving(fence: FenceParams) -> Bench:
    bench = ready(replace(KernelParams(), fence=fence))
    assert not start(bench)
    return bench


@pytest.mark.parametrize("fence", [FenceParams(radius_m=0.2), FenceParams(corners_m=SQUARE)])
def test_a_robot_that_leaves_the_fence_stops_and_starts_only_inside(fence: FenceParams) -> None:
    bench = driving(fence)
    bench.odometry(Pose(-0.01, 0.1, 0.0))
    if fence.radius_m:
        assert bench.state.mode is Mode.MOVING
        bench.odometry(Pose(-0.201, 0.0, 0.0))
    assert stopped_by(bench, Cause.FENCE_LEFT, Mode.ERROR)
    assert not reset(bench)
    bench.odometry(Pose(0.1, 0.1, 0.0))
    assert reset(bench)
    assert not start(bench)


def test_the_fence_stands_where_the_first_motion_began_and_stays_there() -> None:
    bench = driving(FenceParams(radius_m=1.0))
    assert bench.state.health.fence_origin == ORIGIN
    bench.request(Mode.ERROR)
    reset(bench)
    bench.odometry(Pose(0.4, 0.0, 0.0))
    assert not start(bench)
    assert bench.state.health.fence_origin == ORIGIN


def test_without_a_fence_nothing_stops() -> None:
    bench = driving(FenceParams())
    bench.odometry(Pose(0.45, 0.0, 0.0))
    assert bench.state.mode is Mode.MOVING


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [(0.5, 0.5, True), (0.5, 3.9, True), (3.9, 0.5, True), (2.0, 2.0, False), (-0.1, 0.5, False)],
)
def test_a_polygon_may_be_concave(x: float, y: float, inside: bool) -> None:
    assert is_inside(x, y, L_SHAPE) is inside
    assert is_inside(x, y, L_SHAPE[::-1]) is inside


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [(1.9, 2.0, True), (1.4, 2.0, False), (4.1, 2.0, True), (4.6, 2.0, False), (3.0, 4.0, True)],
)
def test_a_side_of_a_polygon_may_slant(x: float, y: float, inside: bool) -> None:
    triangle = corners_of("1,1 5,1 3,5")
    assert is_inside(x, y, triangle) is inside
    assert is_inside(x, y, triangle[::-1]) is inside


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [(0.0, 1.0, True), (1.0, 0.0, True), (2.0, 1.0, False), (1.0, 2.0, False)],
)
def test_the_left_and_the_lower_side_of_an_area_belong_to_it_alone(
    x: float, y: float, inside: bool
) -> None:
    """So a place on the line between two areas is in one of them."""
    assert is_inside(x, y, corners_of(SQUARE)) is inside
    assert is_inside(x, y, corners_of("2,0 4,0 4,2 2,2")) is (x == 2.0)


@pytest.mark.parametrize(("x", "inside"), [(-2.0, False), (0.0, True), (2.0, False)])
def test_a_corner_as_far_ahead_as_the_robot_does_not_count_twice(x: float, inside: bool) -> None:
    diamond = corners_of("0,-1 1,0 0,1 -1,0")
    assert is_inside(x, 0.0, diamond) is inside
    assert is_inside(x, 0.0, diamond[::-1]) is inside


@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-pi, pi), st.floats(0.0, 1.9), st.floats(0, 6))
def test_the_fence_turns_and_moves_with_the_start(
    x: float, y: float, theta: float, distance_m: float, angle: float
) -> None:
    fence, origin = FenceParams(2.0, "-2,-2 2,-2 2,2 -2,2"), Pose(x, y, theta)
    local = Pose(distance_m * cos(angle), distance_m * sin(angle), 0.0)
    assert left_by(fence, origin, origin.compose(local)) == ""
    far = Pose(4.0 * cos(angle), 4.0 * sin(angle), 0.0)
    assert "4.00 m from its start" in left_by(fence, origin, origin.compose(far))


def test_the_line_of_a_round_fence_belongs_to_it() -> None:
    assert left_by(FenceParams(radius_m=5.0), ORIGIN, Pose(3.0, 4.0, 0.0)) == ""


@pytest.mark.parametrize("pose", [Pose(nan, 0.0, 0.0), Pose(0.0, inf, 0.0)])
def test_a_pose_that_is_no_number_is_outside(pose: Pose) -> None:
    assert left_by(FenceParams(radius_m=1.0), ORIGIN, pose)
    assert left_by(FenceParams(corners_m="-1,-1 1,-1 1,1 -1,1"), ORIGIN, pose)


def test_a_fence_has_up_to_64_corners() -> None:
    assert len(corners_of("0,0 1,0 " * 32)) == 64


@pytest.mark.parametrize(
    "corners", ["0,0 1,1", "0,0 1,0 nan,1", "0,0 1,0 1", "a", "0,0,0 1,0 1,1", "0,0 " * 65, 7]
)
def test_a_fence_of_two_points_or_no_numbers_is_refused(corners: object) -> None:
    with pytest.raises(ConfigError, match="use 3 to 64 corners"):
        with_setting(Config(), "fence.corners_m", corners)
