"""Plane geometry: frames, angles, and the heading of an orientation.

The fence: a robot that leaves it stops, and starts again only inside.
A command is finite and within its limits for every target.
The kernel's own sin, cos, atan2 and hypot: accurate, and the same bits on each processor.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from math import cos, inf, isclose, isnan, nan, pi, sin

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from robotctl.base.errors import ConfigError
from robotctl.config import Config, with_setting
from robotctl.kernel import trigonometry
from robotctl.kernel.fence import FenceParams, corners_of, is_inside, left_by
from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle, yaw_of
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.patterns import PatternKind
from robotctl.kernel.tracking import clamp, limit, within
from robotctl.kernel.types import ZERO, Cause, Twist
from robotctl.testing.kernels import Bench, moving, ready, reset, start, stopped_by
from tests.support.cases import for_each

ANGLE = st.floats(-3.0, 3.0)
COORDINATE = st.floats(-100.0, 100.0)


def quaternion(yaw: float, pitch: float, roll: float) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a rotation about z, then y, then x, by Hamilton's product."""
    x, y, z, w = 0.0, 0.0, sin(yaw / 2), cos(yaw / 2)
    for axis, angle in ((1, pitch), (0, roll)):
        turn, rest = sin(angle / 2), cos(angle / 2)
        i, j = (turn, 0.0) if axis == 0 else (0.0, turn)
        x, y, z, w = (
            w * i + x * rest - z * j,
            w * j + y * rest + z * i,
            z * rest + x * j - y * i,
            w * rest - x * i - y * j,
        )
    return x, y, z, w


@given(ANGLE, st.floats(-1.4, 1.4), ANGLE)
def test_the_yaw_of_an_orientation_does_not_depend_on_pitch_and_roll(
    yaw: float, pitch: float, roll: float
) -> None:
    assert isclose(yaw_of(*quaternion(yaw, pitch, roll)), yaw, abs_tol=1e-9)


@for_each("turned", [(0.0, 0.0, 0.0), (0.7, 0.3, -0.5), (-2.0, 1.0, 2.5)])
@for_each(("length", "is_one"), [(0.89, False), (0.91, True), (1.09, True), (1.11, False)])
def test_an_orientation_may_be_a_tenth_too_long_or_too_short(
    turned: tuple[float, float, float], length: float, is_one: bool
) -> None:
    x, y, z, w = (length * part for part in quaternion(*turned))
    assert isnan(yaw_of(x, y, z, w)) is not is_one


@for_each(
    ("angle", "same"),
    [
        (0.0, 0.0),
        (3.0, 3.0),
        (-3.0, -3.0),
        (pi, -pi),
        (-pi, -pi),
        (4.0, 4.0 - 2 * pi),
        (9.0, 9.0 - 2 * pi),
    ],
)
def test_an_angle_is_wrapped_to_half_a_turn_each_way(angle: float, same: float) -> None:
    assert isclose(wrap_angle(angle), same, abs_tol=1e-12)


@given(COORDINATE, COORDINATE, ANGLE, COORDINATE, COORDINATE, ANGLE)
def test_a_pose_composed_is_turned_and_moved(
    x: float, y: float, theta: float, local_x: float, local_y: float, turn: float
) -> None:
    """Compared with complex numbers, whose product is a rotation."""
    composed = Pose(x, y, theta).compose(Pose(local_x, local_y, turn))
    there = complex(x, y) + complex(cos(theta), sin(theta)) * complex(local_x, local_y)
    assert isclose(composed.x, there.real, abs_tol=1e-9)
    assert isclose(composed.y, there.imag, abs_tol=1e-9)
    assert isclose(composed.theta, wrap_angle(theta + turn), abs_tol=1e-12)


SQUARE = "0,0 2,0 2,2 0,2"
L_SHAPE = corners_of("0,0 4,0 4,1 1,1 1,4 0,4")


def driving(fence: FenceParams) -> Bench:
    bench = ready(replace(KernelParams(), fence=fence))
    assert not start(bench)
    return bench


@for_each("fence", [FenceParams(radius_m=0.2), FenceParams(corners_m=SQUARE)])
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


@for_each(
    ("x", "y", "inside"),
    [(0.5, 0.5, True), (0.5, 3.9, True), (3.9, 0.5, True), (2.0, 2.0, False), (-0.1, 0.5, False)],
)
def test_a_polygon_may_be_concave(x: float, y: float, inside: bool) -> None:
    assert is_inside(x, y, L_SHAPE) is inside
    assert is_inside(x, y, L_SHAPE[::-1]) is inside


@for_each(
    ("x", "y", "inside"),
    [(1.9, 2.0, True), (1.4, 2.0, False), (4.1, 2.0, True), (4.6, 2.0, False), (3.0, 4.0, True)],
)
def test_a_side_of_a_polygon_may_slant(x: float, y: float, inside: bool) -> None:
    triangle = corners_of("1,1 5,1 3,5")
    assert is_inside(x, y, triangle) is inside
    assert is_inside(x, y, triangle[::-1]) is inside


@for_each(
    ("x", "y", "inside"), [(0.0, 1.0, True), (1.0, 0.0, True), (2.0, 1.0, False), (1.0, 2.0, False)]
)
def test_the_left_and_the_lower_side_of_an_area_belong_to_it_alone(
    x: float, y: float, inside: bool
) -> None:
    """So a place on the line between two areas is in one of them."""
    assert is_inside(x, y, corners_of(SQUARE)) is inside
    assert is_inside(x, y, corners_of("2,0 4,0 4,2 2,2")) is (x == 2.0)


@for_each(("x", "inside"), [(-2.0, False), (0.0, True), (2.0, False)])
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


@for_each("pose", [Pose(nan, 0.0, 0.0), Pose(0.0, inf, 0.0)])
def test_a_pose_that_is_no_number_is_outside(pose: Pose) -> None:
    assert left_by(FenceParams(radius_m=1.0), ORIGIN, pose)
    assert left_by(FenceParams(corners_m="-1,-1 1,-1 1,1 -1,1"), ORIGIN, pose)


def test_a_fence_has_up_to_64_corners() -> None:
    assert len(corners_of("0,0 1,0 " * 32)) == 64


@for_each(
    "corners", ["0,0 1,1", "0,0 1,0 nan,1", "0,0 1,0 1", "a", "0,0,0 1,0 1,1", "0,0 " * 65, 7]
)
def test_a_fence_of_two_points_or_no_numbers_is_refused(corners: object) -> None:
    with pytest.raises(ConfigError, match="use 3 to 64 corners"):
        with_setting(Config(), "fence.corners_m", corners)


LIMITS = VelocityLimits(1.0, 2.0, 0.5, 4.0)


@for_each("value", [nan, inf, -inf])
def test_what_is_not_finite_becomes_zero_never_full_speed(value: float) -> None:
    assert clamp(value, 1.0) == 0.0
    assert limit(ZERO, Twist(value, value), 10.0, LIMITS) == ZERO


def test_a_command_changes_no_faster_than_allowed() -> None:
    assert limit(ZERO, Twist(9.0, -9.0), 0.1, LIMITS) == Twist(0.05, -0.4)
    assert limit(Twist(0.5, 0.0), ZERO, 0.1, LIMITS) == Twist(0.45, 0.0)
    assert limit(Twist(0.01, 0.0), ZERO, 0.1, LIMITS) == ZERO


@for_each("command", [Twist(1.1, 0.0), Twist(0.0, -2.1), Twist(nan, 0.0)])
def test_a_command_beyond_the_limits_is_told(command: Twist) -> None:
    assert not within(command, LIMITS)
    assert within(Twist(1.0, -2.0), LIMITS)


def test_a_kernel_goes_on_from_a_state_of_other_limits() -> None:
    state = moving(ticks=30).state
    limits = VelocityLimits(0.1, 0.2, 0.5, 4.0)
    assert not within(state.command, limits)
    kernel = Kernel(replace(KernelParams(), limits=limits), state)
    assert kernel.state.command.linear == 0.1
    assert Kernel(KernelParams(), state).state == state


WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2"}

ANGLES = (
    st.floats(-1e5, 1e5)
    | st.floats(-10.0, 10.0)
    | st.integers(-999, 999).map(lambda quarters: quarters * math.pi / 2)
)
COORDINATES = st.floats(allow_nan=False) | st.floats(-10.0, 10.0)


def is_near(own: float, exact: float, ulps: int) -> bool:
    if math.isinf(exact) or exact == 0.0:
        return repr(own) == repr(exact)
    return abs(own - exact) <= ulps * math.ulp(exact)


@pytest.mark.parametrize(("name", "ulps"), [("sin", 1), ("cos", 1), ("tan", 2)])
@given(angle=ANGLES)
def test_a_function_of_an_angle_is_exact_to_the_last_bit(
    name: str, ulps: int, angle: float
) -> None:
    own: Callable[[float], float] = getattr(trigonometry, name)
    assert is_near(own(angle), getattr(math, name)(angle), ulps)


@given(x=COORDINATES, y=COORDINATES)
@example(x=math.inf, y=-math.inf)
@example(x=-0.0, y=-0.0)
@example(x=5e-324, y=1e308)
def test_direction_and_length_are_exact_to_the_last_bits(x: float, y: float) -> None:
    assert is_near(trigonometry.atan2(y, x), math.atan2(y, x), 1)
    assert is_near(trigonometry.hypot(x, y), math.hypot(x, y), 2)


@given(x=st.floats(-30.0, 30.0))
def test_the_exponential_function_is_exact_to_the_last_bit(x: float) -> None:
    assert is_near(trigonometry.exp(x), math.exp(x), 1)


def test_what_is_no_number_is_none_and_an_infinite_angle_is_refused() -> None:
    assert all(math.isnan(each(math.nan)) for each in (trigonometry.sin, trigonometry.cos))
    assert all(math.isnan(each(math.nan, 1.0)) for each in (trigonometry.atan2, trigonometry.hypot))
    assert trigonometry.sin(1e15) == pytest.approx(math.sin(1e15 % math.tau), abs=1e-15)
    for function in (trigonometry.sin, trigonometry.cos, trigonometry.tan, trigonometry.exp):
        with pytest.raises(ValueError, match=r"infinite|between"):
            function(math.inf)


DRIVES = """
import hashlib
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import DriveRequested
from robotctl.testing.drives import BEGIN_NS, drive

for kind in PatternKind:
    request = DriveRequested(BEGIN_NS + 10**8, 1, Pattern(kind), 0, False, "operator")
    written = drive(6.0, requests=[request])
    print(kind, hashlib.sha256(repr(written).encode()).hexdigest())
"""


def test_a_processor_without_fused_multiply_add_drives_the_same_bit_for_bit() -> None:
    """With the sin and atan2 of the C library each of these drives differs."""
    drives = [
        subprocess.run(
            [sys.executable, "-c", DRIVES],
            env={**os.environ, **tunables},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for tunables in ({}, WITHOUT_FMA)
    ]
    assert drives[0].count("\n") == len(PatternKind)
    assert drives[0] == drives[1]


@for_each("length", [0.9, 1.1])
def test_an_orientation_that_is_a_tenth_off_is_still_one(length: float) -> None:
    assert yaw_of(0.0, 0.0, 0.0, length) == 0.0
