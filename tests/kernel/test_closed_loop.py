"""Every pattern in closed loop on virtual time, over bases, noise, limits and rates."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import pi
from random import Random

import pytest

from robotctl.kernel.course import Course, Point
from robotctl.kernel.geometry import Pose, wrap_angle
from robotctl.kernel.params import KernelParams, TrackingParams, VelocityLimits
from robotctl.kernel.patterns import Pattern, PatternKind, path_of
from robotctl.kernel.tracking import limit
from robotctl.sim.robot import SimParams
from robotctl.testing.kernels import drive_simulated

BENDS: tuple[Point, ...] = ((0.0, 0.0), (0.8, 0.0), (1.2, 0.6), (0.4, 1.0))
TURNED = Pose(0.0, 0.0, pi)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("kind", [*PatternKind, None])
def test_every_pattern_is_driven_near_its_path_within_the_limits_to_its_end_in_time(
    kind: PatternKind | None, seed: int
) -> None:
    """A kind of None stands for waypoints; the lag of the base is told, as it should be."""
    draw = Random(f"{kind} {seed}")
    limits = VelocityLimits(
        draw.uniform(0.2, 1.0), draw.uniform(0.8, 2.0), draw.uniform(0.5, 2.0), draw.uniform(4, 8)
    )
    base = SimParams(
        lag_s=draw.uniform(0.02, 0.06),
        linear_accel_mps2=50.0,
        angular_accel_rps2=100.0,
        actuation_linear_factor=draw.uniform(0.95, 1.05),
        actuation_angular_factor=draw.uniform(0.95, 1.05),
        odometry_rate_hz=draw.choice((50.0, 100.0)),
        seed=draw.randrange(1000),
    )
    exact = replace(
        base,
        lag_s=0.0,
        actuation_linear_factor=1.0,
        actuation_angular_factor=1.0,
        actuation_noise=0.0,
        odometry_noise=0.0,
    )
    reverse, rate_hz = draw.random() < 0.5, draw.choice((50.0, 100.0))
    angle_rad = draw.choice((-1.0, 1.0)) * draw.uniform(0.3, 4.0)
    waypoints = BENDS if kind is None else ()
    course = Course(angle_rad=angle_rad, reverse=reverse, waypoints=waypoints)
    speed_mps = draw.uniform(0.3, 1.0) * min(limits.linear_mps, 0.6)
    pattern = Pattern(kind or PatternKind.SQUARE, draw.uniform(0.5, 1.5), speed_mps)
    params = KernelParams(limits=limits, tracking=TrackingParams(lag_s=base.lag_s))
    driven = drive_simulated(pattern, rate_hz=rate_hz, sim=base, course=course, params=params)
    report = driven.ended.report
    assert driven.ended.completed
    assert report.cross_track_max_m <= 0.03
    assert report.cross_track_rms_m <= 0.01
    for before, command in pairwise(driven.commands):
        assert limit(before, command, 1.0 / rate_hz + 1e-9, limits) == command
    end = path_of(pattern, course, again=False).end
    if reverse:  # a pattern lies behind the robot; waypoints are places, reached rear first
        end = end.compose(TURNED) if kind is None else TURNED.compose(end).compose(TURNED)
    assert driven.pose.distance(end) <= 0.03
    assert abs(wrap_angle(driven.pose.theta - end.theta)) <= 0.04
    params = replace(params, tracking=TrackingParams(lag_s=0.0))
    ideal = drive_simulated(pattern, rate_hz=rate_hz, sim=exact, course=course, params=params)
    assert driven.duration_s <= 1.2 * ideal.duration_s + 0.5
