"""The limits of a command, and path tracking (Samson 1993; Klancar and Skrjanc 2005, eq. 11)."""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, isfinite

from robotctl.kernel.geometry import Pose
from robotctl.kernel.params import TrackingParams, VelocityLimits
from robotctl.kernel.trigonometry import direction
from robotctl.kernel.types import Twist


def clamp(value: float, bound: float) -> float:
    """Return `value` limited to [-bound, bound], 0 for nan and inf."""
    if -bound <= value <= bound:
        return value
    return copysign(bound, value) if isfinite(value) else 0.0


def _approach(current: float, target: float, max_step: float) -> float:
    if -max_step <= target - current <= max_step:
        return target
    return current + max_step if target > current else current - max_step


def allowed(command: Twist, limits: VelocityLimits) -> Twist:
    """Return the command limited to the velocity limits, with 0 for nan and inf."""
    return Twist(
        clamp(command.linear, limits.linear_mps), clamp(command.angular, limits.angular_rps)
    )


def limit(current: Twist, target: Twist, dt_s: float, limits: VelocityLimits) -> Twist:
    """Return the command nearest to `target` within the `limits`, `dt_s` [s] after `current`."""
    linear = clamp(target.linear, limits.linear_mps)
    angular = clamp(target.angular, limits.angular_rps)
    return Twist(
        _approach(current.linear, linear, limits.linear_accel_mps2 * dt_s),
        _approach(current.angular, angular, limits.angular_accel_rps2 * dt_s),
    )


def within(command: Twist, limits: VelocityLimits) -> bool:
    """Return whether the command is finite and within the velocity limits."""
    linear_mps, angular_rps = limits.linear_mps, limits.angular_rps
    return (
        -linear_mps <= command.linear <= linear_mps
        and -angular_rps <= command.angular <= angular_rps
    )


@dataclass(frozen=True, slots=True)
class Reference:
    """The wanted pose and motion of the robot on its path.

    `linear` is the speed along the path [m/s], `curvature` the curvature of the path [1/m], and
    `turning` the rate of a turn on the spot [rad/s].
    """

    pose: Pose
    linear: float
    curvature: float
    turning: float


def track(reference: Reference, pose: Pose, gains: TrackingParams, limits: VelocityLimits) -> Twist:
    """Return a command that leads a robot at `pose` to the reference; only `linear` is limited."""
    error = pose.express(reference.pose)
    ahead, aside = direction(error.theta)
    sinc = aside / error.theta if abs(error.theta) > 1e-6 else 1.0
    linear = clamp(reference.linear * ahead + gains.k_x * error.x, limits.linear_mps)
    # Curvature is fed forward at the commanded speed: a robot that catches up stays on the path.
    return Twist(
        linear,
        reference.turning
        + reference.curvature * linear
        + gains.k_y * reference.linear * sinc * error.y
        + gains.k_theta * error.theta,
    )


def follow_blindly(reference: Reference) -> Twist:
    """Return the velocity of the reference as an open-loop command, without odometry feedback."""
    turning = reference.turning + reference.curvature * reference.linear
    return Twist(reference.linear, turning)
