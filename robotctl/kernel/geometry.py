"""Plane geometry in the conventions of REP-103: metres, radians, counter-clockwise positive."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan, pi, tau

from robotctl.kernel.trigonometry import atan2, direction, hypot


def wrap_angle(angle_rad: float) -> float:
    """Return the angle in [-pi, pi) that has the same direction."""
    return (angle_rad + pi) % tau - pi


@dataclass(frozen=True, slots=True)
class Pose:
    """A position x, y [m] and a heading theta [rad]."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def compose(self, local: Pose) -> Pose:
        """Return `local`, given relative to this pose, as a pose in this pose's parent frame."""
        c, s = direction(self.theta)
        return Pose(
            self.x + c * local.x - s * local.y,
            self.y + s * local.x + c * local.y,
            wrap_angle(self.theta + local.theta),
        )

    def express(self, other: Pose) -> Pose:
        """Return `other` relative to this pose; both are given in the same parent frame."""
        c, s = direction(self.theta)
        dx, dy = other.x - self.x, other.y - self.y
        return Pose(c * dx + s * dy, c * dy - s * dx, wrap_angle(other.theta - self.theta))

    def distance(self, other: Pose) -> float:
        """Return the distance between the two positions [m]."""
        return hypot(other.x - self.x, other.y - self.y)


ORIGIN = Pose()


QUATERNION_TOLERANCE = 0.1
"""The largest difference between the length of a quaternion and 1."""

_SHORTEST, _LONGEST = (1.0 - QUATERNION_TOLERANCE) ** 2, (1.0 + QUATERNION_TOLERANCE) ** 2


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """Return a quaternion's rotation about the z axis [rad], NaN if its length is not about 1."""
    if not _SHORTEST <= x * x + y * y + z * z + w * w <= _LONGEST:
        return nan
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
