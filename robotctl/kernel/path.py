"""A path: the segments of one lap, in the frame of the pose where the drive begins."""

from __future__ import annotations

from dataclasses import dataclass

from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.segments import Segment

NEAR_M = 0.05
"""How far behind the reference the path is searched for its nearest point."""

OUTLINE_PIECES = 180
"""The poses along all curves of an outline together."""


@dataclass(frozen=True, slots=True)
class Path:
    """The segments of one lap, each beginning where the one before ends.

    `reach_m` is the size of the path: a robot that is further from its reference than this does not
    follow it. A path is `closed` if it ends at the pose where it begins. That of a held velocity
    has no segments.
    """

    segments: tuple[Segment, ...]
    reach_m: float
    closed: bool = True
    end: Pose = ORIGIN

    def distance_to(self, point: Pose, index: int, length: float) -> float:
        """Return the distance of `point` from the path near `length` in segment `index` [m]."""
        segment = self.segments[index]
        if segment.turns:
            return self._distance_to_sides(point, index)
        nearest_m, searched_m = segment.distance_to(point, length), length
        while searched_m < NEAR_M:
            before = self._neighbour(index, -1)
            if before is None or before.turns:
                break
            nearest_m = min(nearest_m, before.distance_to(point, before.length))
            searched_m += before.length
            index -= 1
        return nearest_m

    def _distance_to_sides(self, point: Pose, index: int) -> float:
        """Return the distance in a corner, from the side before it or the side after it [m]."""
        before, after = self._neighbour(index, -1), self._neighbour(index, 1)
        distances_m = [] if before is None else [before.distance_to(point, before.length)]
        if after is not None:
            distances_m.append(after.distance_to(point, 0.0))
        return min(distances_m, default=self.segments[index].distance_to(point, 0.0))

    def outline(self) -> tuple[Pose, ...]:
        """Return the corners of the lap and poses along its curves, to draw it."""
        curves = sum(1 for segment in self.segments if _bends(segment))
        pieces_of_curve = max(1, OUTLINE_PIECES // max(1, curves))
        poses = [segment.pose_at(0.0) for segment in self.segments[:1]] or [ORIGIN]
        for segment in self.segments:
            pieces = pieces_of_curve if _bends(segment) else 1
            poses += [segment.pose_at(segment.length * (i + 1) / pieces) for i in range(pieces)]
        return tuple(poses)

    def _neighbour(self, index: int, step: int) -> Segment | None:
        """Return the segment before (-1) or after (1) another one, None beyond an open end."""
        other = index + step
        if not self.closed and not 0 <= other < len(self.segments):
            return None
        return self.segments[other % len(self.segments)]


def _bends(segment: Segment) -> bool:
    return not segment.turns and segment.top_curvature > 0.0
