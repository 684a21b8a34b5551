"""The limits of a command: finite, not too fast, and not changing too fast."""

from __future__ import annotations

from math import copysign, isfinite

from robotctl.kernel.params import VelocityLimits
from robotctl.kernel.types import Twist


def clamp(value: float, bound: float) -> float:
    """Return `value` limited to [-bound, bound]; nan and inf become 0, never full speed."""
    if -bound <= value <= bound:
        return value
    return copysign(bound, value) if isfinite(value) else 0.0


def _approach(current: float, target: float, max_step: float) -> float:
    if -max_step <= target - current <= max_step:
        return target
    return current + max_step if target > current else current - max_step


def allowed(command: Twist, limits: VelocityLimits) -> Twist:
    """Return the command limited to the velocity limits; nan and inf become 0."""
    return Twist(
        clamp(command.linear, limits.linear_mps), clamp(command.angular, limits.angular_rps)
    )


def limit(current: Twist, target: Twist, dt_s: float, limits: VelocityLimits) -> Twist:
    """Return the command nearest to `target` that is allowed `dt_s` seconds after `current`."""
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
