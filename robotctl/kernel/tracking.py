"""Closed-loop path tracking for a differential drive.

The law is Samson's (1993), in the notation of Klancar and Skrjanc (2005), eq. 11: beside the terms
of Kanayama (1990) it corrects the heading also while the reference turns on the spot. The curvature
of the path is fed forward at the speed that is commanded, not at the reference's, so that a robot
which catches up stays on the path.
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
    """Where the robot should be now and how it should move on.

    `linear` is the speed along the path [m/s], `curvature` that of the path [1/m], `turning` the
    rate of a turn on the spot [rad/s].
    """

    pose: Pose
    linear: float
    curvature: float
    turning: float


def track(reference: Reference, pose: Pose, gains: TrackingParams, limits: VelocityLimits) -> Twist:
    """Return the command that leads `pose` to the moving reference."""
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
