"""The path that a recorded robot drove, as waypoints to drive again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from math import hypot
from pathlib import Path

from robotctl.base.errors import UnreadableFile
from robotctl.check.journal import Gap, in_sequence, read_effect, read_event, read_snapshot
from robotctl.kernel.course import MAX_POINTS, Frame, Point
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.odometry import is_finite
from robotctl.kernel.types import ModeChanged, OdomReceived
from robotctl.messages.cdr import ODOMETRY
from robotctl.messages.inputs import read_odometry
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import journal_topic, read_journal

SPACING_M = 0.03  # a robot may roll a little at a stop
"""A pose nearer than this to the last point is skipped."""

TOLERANCE_M = 0.005
"""The maximum distance of a driven point from the path through the waypoints."""


def driven_path(path: Path, frame: Frame, on_missing: Callable[[str], None]) -> tuple[Point, ...]:
    """Return waypoints of the last motion in a recording, () if the robot did not drive.

    Without a journal, the waypoints follow all recorded odometry. `on_missing` gets a sentence
    about each unreadable part of the recording.

    Raises:
        UnreadableFile: The recording cannot be read, or a part of the motion is missing.
    """
    with Recording(path) as recording:
        missing = list(recording.missing)
        if journal_topic(recording.info()) is None:
            topics = recording.info().topics
            name = next((topic.name for topic in topics if topic.type_name == ODOMETRY), None)
            poses = [] if name is None else list(_poses(recording, name, missing))
            is_whole = not missing
        else:
            motion = _last_motion(recording, missing)
            poses, is_whole = motion.poses, motion.is_whole
    places = _spaced(poses)
    if len(places) > 1 and not is_whole:
        told = "; ".join(missing) or "it ends while the robot is MOVING"
        raise UnreadableFile(f"{path} holds only a part of its last motion: {told}")
    for sentence in missing:
        on_missing(sentence)
    if len(places) < 2:
        return ()
    if frame is Frame.START:
        local = (poses[0].express(Pose(x, y)) for x, y in places)
        places = [(pose.x, pose.y) for pose in local]
    tolerance_m = TOLERANCE_M
    points = simplified(places, tolerance_m)
    while len(points) > MAX_POINTS:
        tolerance_m *= 2.0
        points = simplified(places, tolerance_m)
    return points


def simplified(points: Sequence[Point], tolerance_m: float) -> tuple[Point, ...]:
    """Return some of the points: each one left out is within `tolerance_m` of the returned path.

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
    """Return the distance [m] of `point` from the line segment from `begin` to `end`."""
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


@dataclass(slots=True)
class _Motion:
    """The poses of a motion (the robot is MOVING), and whether its start and end are recorded."""

    poses: list[Pose] = field(default_factory=list)
    begins: bool = False
    ends: bool = False

    @property
    def is_whole(self) -> bool:
        return self.begins and self.ends

    @property
    def goes_anywhere(self) -> bool:
        return len(_spaced(self.poses)) > 1


def _last_motion(recording: Recording, missing: list[str]) -> _Motion:
    """Return the last motion in which the robot moved, or one without poses if there is none."""
    last = present = _Motion()
    moving = False
    for entry in in_sequence(_entries(recording, missing)):
        if isinstance(entry, Gap):
            note_missing(missing, entry.text)
            present.begins = False
            continue
        was_moving, moving = moving, _moves(entry, moving)
        if moving and not was_moving:
            present = _Motion(begins=entry.kind is EntryKind.EFFECT)
        elif was_moving and not moving:
            present.ends = True
            last = present if present.goes_anywhere else last
        elif moving and entry.name == OdomReceived.__name__:
            event = read_event(entry)
            if isinstance(event, OdomReceived) and is_finite(event.odometry):
                present.poses.append(event.odometry.pose)
    return present if moving and present.goes_anywhere else last


def _entries(recording: Recording, missing: list[str]) -> Iterator[JournalEntry]:
    """Yield the readable entries of the journal."""
    try:
        for _, entry in read_journal(recording, lambda text: note_missing(missing, text)):
            yield entry
    except UnreadableFile as error:
        note_missing(missing, str(error))


def _moves(entry: JournalEntry, moving: bool) -> bool:
    """Return whether the robot is MOVING after an entry."""
    if entry.kind is EntryKind.SNAPSHOT:
        return read_snapshot(entry).state.mode is Mode.MOVING
    if entry.kind is EntryKind.EFFECT and entry.name == ModeChanged.__name__:
        changed = read_effect(entry)
        return isinstance(changed, ModeChanged) and changed.mode is Mode.MOVING
    return moving


def _poses(recording: Recording, topic: str, missing: list[str]) -> Iterator[Pose]:
    for message in recording.messages({topic}, lambda text: note_missing(missing, text)):
        odometry = read_odometry(message.data)
        if is_finite(odometry):
            yield odometry.pose
