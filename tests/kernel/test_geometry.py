"""Plane geometry: frames, angles, and the heading of an orientation."""

from __future__ import annotations

from math import cos, isclose, isnan, nextafter, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.geometry import ORIGIN, Pose, wrap_angle, yaw_of

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


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (0.7, 0.3, -0.5), (-2.0, 1.0, 2.5)])
@pytest.mark.parametrize(
    ("length", "is_one"), [(0.89, False), (0.91, True), (1.09, True), (1.11, False)]
)
def test_an_orientation_may_be_a_tenth_too_long_or_too_short(
    turned: tuple[float, float, float], length: float, is_one: bool
) -> None:
    x, y, z, w = (length * part for part in quaternion(*turned))
    assert isnan(yaw_of(x, y, z, w)) is not is_one


@pytest.mark.parametrize("length", [0.9, 1.1])
def test_an_orientation_that_is_a_tenth_off_is_still_one(length: float) -> None:
    assert yaw_of(0.0, 0.0, 0.0, length) == 0.0


@pytest.mark.parametrize(
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


@pytest.mark.parametrize("angle", [nextafter(pi, 4.0), -1.0 - 2.0**-51, 2.0, 9.0, -pi])
def test_an_angle_that_was_wrapped_stays_the_same_number(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert wrap_angle(wrapped) == wrapped


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


def test_a_distance_is_that_of_pythagoras() -> None:
    assert Pose(1.0, 2.0, 0.3).distance(Pose(4.0, 6.0, -0.3)) == 5.0
    assert Pose(4.0, 6.0).distance(Pose(1.0, 2.0)) == 5.0
    assert Pose(0.0, 0.0, 0.0) == ORIGIN
