"""Which odometry can be true, and which is news."""

from __future__ import annotations

from math import isfinite

from robotctl.kernel.geometry import wrap_angle
from robotctl.kernel.health import Health
from robotctl.kernel.params import OdometryParams
from robotctl.kernel.types import Odometry


def odometry_fault(health: Health, odometry: Odometry, params: OdometryParams) -> str:
    """Return why this sample cannot be true, "" if it can.

    Stamps are compared with the sample before, true or not: they come from a wall clock, which may
    be set back once without harm.
    """
    last = health.odometry
    if not is_finite(odometry):
        return "odometry is not finite"
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
