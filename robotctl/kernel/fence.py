"""The area that the robot must not leave, relative to its pose at the start of the first motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from math import isfinite

from robotctl.kernel.geometry import Pose
from robotctl.kernel.ranges import Change, bounded, setting

Corner = tuple[float, float]
"""x, y [m] in the frame of the pose at the start of the first motion."""

MAX_CORNERS = 64


@dataclass(frozen=True, slots=True)
class FenceParams:
    """The circle and the polygon around the robot's allowed area, 0 or "" for none."""

    radius_m: float = bounded(
        0.0, 0.0, 1e5, "m", "distance from the start of the first motion; 0: no limit", Change.START
    )
    corners_m: str = setting(
        "", "corners x,y of the allowed area, such as -1,-1 3,-1 3,2", Change.START, corners=True
    )


@lru_cache(maxsize=8)
def corners_of(text: str) -> tuple[Corner, ...]:
    """Return the corners of a polygon such as `0,0 2,0 2,1`, () for "".

    Raises:
        ValueError: The text does not name 3 to 64 finite corners.
    """
    if not text:
        return ()
    corners = []
    for corner in text.split():
        x, y = map(float, corner.split(","))
        corners.append((x, y))
    if not 3 <= len(corners) <= MAX_CORNERS or not all(map(isfinite, chain(*corners))):
        raise ValueError(f"{text!r} has no 3 to {MAX_CORNERS} finite corners")
    return tuple(corners)


def is_inside(x: float, y: float, corners: tuple[Corner, ...]) -> bool:
    """Return whether a point lies in the polygon."""
    inside = False
    last_x, last_y = corners[-1]
    for corner_x, corner_y in corners:
        if (corner_y > y) is not (last_y > y):
            crossing = corner_x + (y - corner_y) * (last_x - corner_x) / (last_y - corner_y)
            inside ^= x < crossing
        last_x, last_y = corner_x, corner_y
    return inside


def left_by(params: FenceParams, origin: Pose, pose: Pose) -> str:
    """Return a sentence if `pose` is outside the fence at `origin`, else ""."""
    distance_m = origin.distance(pose)
    if params.radius_m and not distance_m <= params.radius_m:
        return f"the robot is {distance_m:.2f} m from its start, more than {params.radius_m:g} m"
    if params.corners_m:
        local = origin.express(pose)
        if not is_inside(local.x, local.y, corners_of(params.corners_m)):
            return f"the robot is outside its area, at x={local.x:.2f} m, y={local.y:.2f} m from it"
    return ""
