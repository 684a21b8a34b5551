"""Closed-loop path tracking for a differential drive.

The law is Samson's (1993), as written by Klancar and Skrjanc (2005), eq. 11. Unlike the law of
Kanayama (1990), it also corrects the heading while the reference turns on the spot. The curvature
is fed forward at the commanded speed, not at that of the reference, so that a robot that catches
up stays on the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

from robotctl.kernel.geometry import Pose
from robotctl.kernel.limits import clamp
from robotctl.kernel.params import TrackingParams, VelocityLimits
from robotctl.kernel.types import Twist


@dataclass(frozen=True, slots=True)
class Reference:
    """The pose that the robot should have now, and how the reference moves.

    `linear` is its speed along the path [m/s], `curvature` the curvature of the path [1/m], and
    `turning` the rate of a turn on the spot [rad/s].
    """

    pose: Pose
    linear: float
    curvature: float
    turning: float


def track(reference: Reference, pose: Pose, gains: TrackingParams, limits: VelocityLimits) -> Twist:
    """Return the command that brings a robot at `pose` to the moving reference."""
    error = pose.express(reference.pose)
    sinc = sin(error.theta) / error.theta if abs(error.theta) > 1e-6 else 1.0
    linear = clamp(reference.linear * cos(error.theta) + gains.k_x * error.x, limits.linear_mps)
    return Twist(
        linear,
        reference.turning
        + reference.curvature * linear
        + gains.k_y * reference.linear * sinc * error.y
        + gains.k_theta * error.theta,
    )


def follow_blindly(reference: Reference) -> Twist:
    """Return the command that moves a perfect robot like the reference, whatever odometry says."""
    turning = reference.turning + reference.curvature * reference.linear
    return Twist(reference.linear, turning)
