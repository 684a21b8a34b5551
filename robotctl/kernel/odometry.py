"""Which odometry can be true, which is news, and which publisher of it is followed."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite

from robotctl.kernel.geometry import wrap_angle
from robotctl.kernel.health import Health, OdometrySources, SecondOdometry
from robotctl.kernel.params import OdometryParams
from robotctl.kernel.types import Odometry, OdometrySourceFound, OdomReceived
from robotctl.kernel.units import NS_PER_S

MAX_NAMED_SOURCES = 16
"""Publishers of odometry whose names are kept; a graph may make new ones without end."""


def odometry_fault(health: Health, odometry: Odometry, params: OdometryParams) -> str:
    """Return why this sample cannot be true, "" if it can.

    Stamps are compared with the sample before, true or not: they come from a wall clock, which may
    be set back once without harm.
    """
    last = health.odometry
    if not is_finite(odometry):
        if isfinite(odometry.pose.theta):
            return "odometry is not finite"
        return "odometry has no valid orientation (its quaternion must have length 1)"
    if last is None:
        return ""
    if odometry.stamp_ns < health.odometry_stamp_ns:
        return "odometry went back in time"
    jump_m = last.pose.distance(odometry.pose)
    if jump_m > params.max_jump_m:
        return f"odometry jumped by {jump_m:.2f} m"
    turned_rad = abs(wrap_angle(odometry.pose.theta - last.pose.theta))
    if not turned_rad <= params.max_jump_rad:  # so is NaN, between two huge angles
        return f"odometry jumped by {turned_rad:.2f} rad"
    return ""


def is_repeated(health: Health, odometry: Odometry) -> bool:
    """Say whether this is the sample before once more, as a source that hangs sends it.

    Without a stamp, 0, nobody can tell it from a robot that stands still.
    """
    return odometry.stamp_ns != 0 and odometry == health.odometry


def is_finite(odometry: Odometry) -> bool:
    """Say whether every number of it is one."""
    pose, velocity = odometry.pose, odometry.velocity
    return (
        isfinite(pose.x)
        and isfinite(pose.y)
        and isfinite(pose.theta)
        and isfinite(velocity.linear)
        and isfinite(velocity.angular)
    )


def source_found(sources: OdometrySources, event: OdometrySourceFound) -> OdometrySources:
    """Return the sources with the name of one of them."""
    others = tuple(named for named in sources.names if named[0] != event.source)
    names = (*others, (event.source, event.name))[-MAX_NAMED_SOURCES:]
    return replace(sources, names=names)


def may_follow(health: Health, event: OdomReceived, params: OdometryParams) -> bool:
    """Say whether a robot that stands may change to the publisher of this sample.

    It may where the publisher that it follows has sent nothing usable for the timeout.
    """
    age_s = abs(event.t_ns - health.odometry_t_ns) / NS_PER_S
    return health.odometry is None or age_s > params.timeout_s


def dropped(health: Health, event: OdomReceived) -> OdometrySources:
    """Return the sources after a sample of a publisher that is not followed."""
    last, pose = health.odometry, event.odometry.pose
    distance_m = angle_rad = 0.0
    if last is not None:
        distance_m = last.pose.distance(pose)
        angle_rad = abs(wrap_angle(pose.theta - last.pose.theta))
    sources = health.odometry_sources
    second = SecondOdometry(event.source, event.t_ns, distance_m, angle_rad)
    return replace(sources, dropped=sources.dropped + 1, second=second)
