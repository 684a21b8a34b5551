"""The places where a recorded robot drove, as waypoints to drive again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import hypot
from pathlib import Path

from robotctl.cdr.known_types import ODOMETRY
from robotctl.cdr.motion import read_odometry
from robotctl.errors import UnreadableFile
from robotctl.kernel.course import MAX_POINTS, Frame, Point
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.odometry import is_finite
from robotctl.kernel.types import ModeChanged, OdomReceived
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.read.journal_reader import read_journal
from robotctl.rerun.journal_values import read_effect, read_event, read_snapshot

SPACING_M = 0.03
"""Places nearer to each other than this are one: a robot that stops may roll a little too far."""

TOLERANCE_M = 0.005
"""How far a place may be beside the waypoints."""


def driven_path(path: Path, frame: Frame) -> tuple[Point, ...]:
    """Return waypoints of the last motion in a recording, or of all odometry without a journal.

    Raises:
        UnreadableFile: The recording cannot be read, or its robot did not drive.
    """
    with Recording(path) as recording:
        poses = _last_motion(recording) or _all_odometry(recording)
    places = _spaced(poses)
    if len(places) < 2:
        raise UnreadableFile(f"{path} holds no path: its robot did not drive")
    if frame is Frame.START:
        begin = poses[0]
        local = [begin.express(Pose(x, y)) for x, y in places]
        places = [(pose.x, pose.y) for pose in local]
    tolerance_m = TOLERANCE_M
    points = simplified(places, tolerance_m)
    while len(points) > MAX_POINTS:
        tolerance_m *= 2.0
        points = simplified(places, tolerance_m)
    return points


def simplified(points: Sequence[Point], tolerance_m: float) -> tuple[Point, ...]:
    """Return those of the points from which no other is further away than the tolerance.

    The algorithm is that of Douglas and Peucker (1973).
    """
    kept = [False] * len(points)
    kept[0] = kept[-1] = True
    spans = [(0, len(points) - 1)]
    while spans:
        first, last = spans.pop()
        farthest, index = tolerance_m, 0
        for each in range(first + 1, last):
            away = _distance(points[each], points[first], points[last])
            if away > farthest:
                farthest, index = away, each
        if index:
            kept[index] = True
            spans += [(first, index), (index, last)]
    return tuple(point for point, keep in zip(points, kept, strict=True) if keep)


def _distance(point: Point, begin: Point, end: Point) -> float:
    """Return the distance of a point from a straight line between two others, ends included."""
    dx, dy = end[0] - begin[0], end[1] - begin[1]
    px, py = point[0] - begin[0], point[1] - begin[1]
    square = dx * dx + dy * dy
    share = min(max((px * dx + py * dy) / square, 0.0), 1.0) if square else 0.0
    return hypot(px - share * dx, py - share * dy)


def _spaced(poses: Sequence[Pose]) -> list[Point]:
    places: list[Point] = []
    for pose in poses:
        if not places or hypot(pose.x - places[-1][0], pose.y - places[-1][1]) >= SPACING_M:
            places.append((pose.x, pose.y))
    return places


def _last_motion(recording: Recording) -> list[Pose]:
    """Return the poses of the last motion that went anywhere, [] without a journal."""
    best: list[Pose] = []
    present: list[Pose] = []
    moving = False
    try:
        for _, entry in read_journal(recording, lambda text: None):
            was_moving, moving = moving, _moves(entry, moving)
            if moving and not was_moving:
                present = []
            elif entry.kind is EntryKind.EVENT and entry.name == OdomReceived.__name__ and moving:
                event = read_event(entry)
                if isinstance(event, OdomReceived) and is_finite(event.odometry):
                    present.append(event.odometry.pose)
            if was_moving and not moving and len(_spaced(present)) > 1:
                best = present
    except UnreadableFile:
        return best
    return present if moving and len(_spaced(present)) > 1 else best


def _moves(entry: JournalEntry, moving: bool) -> bool:
    """Return whether the robot is MOVING after an entry."""
    if entry.kind is EntryKind.SNAPSHOT:
        return read_snapshot(entry).state.mode is Mode.MOVING
    if entry.kind is EntryKind.EFFECT and entry.name == ModeChanged.__name__:
        changed = read_effect(entry)
        return isinstance(changed, ModeChanged) and changed.mode is Mode.MOVING
    return moving


def _all_odometry(recording: Recording) -> list[Pose]:
    topics = recording.info().topics
    name = next((topic.name for topic in topics if topic.type_name == ODOMETRY), None)
    return [] if name is None else list(_poses(recording, name))


def _poses(recording: Recording, topic: str) -> Iterator[Pose]:
    for message in recording.messages({topic}, lambda text: None):
        odometry = read_odometry(message.data)
        if is_finite(odometry):
            yield odometry.pose
