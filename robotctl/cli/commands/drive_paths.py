"""The points of a path: from a file, a recording, or a topic."""

from __future__ import annotations

import base64
import csv
import os
import re
import struct
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from robotctl.base.errors import Refused, UnreadableFile, UsageError
from robotctl.base.files import open_regular
from robotctl.check.driven_path import driven_path
from robotctl.cli.targets.recordings import LAST, committed_recording, find_recording, with_earlier
from robotctl.cli.targets.ros_view import ros_view
from robotctl.cli.ui.text import printable, short_path
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_LIST
from robotctl.kernel.course import MAX_COORDINATE_M, MAX_POINTS, Frame, Point
from robotctl.messages.definition import Definition, parse_definition
from robotctl.messages.values import Decoder

if TYPE_CHECKING:
    import yaml


MAX_BYTES = 64 * MAX_POINTS
"""The maximum size of a file with points [bytes]."""

MAX_SHOWN = 60
"""The maximum length of a wrong point in an error [characters]."""

MCAP = b"\x89MCAP0\r\n"

KINDS = "use CSV with the header x,y, YAML with a list of [x, y], or a recording"

# Python and YAML accept more, such as 0_3 and 1:30.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""A decimal number."""


class _WrittenPoint(NamedTuple):
    """A point of a file: its values as text, its line number, and its original text."""

    values: list[str]
    line: int
    text: str


def read_waypoints(name: str, frame: Frame, robot: str) -> list[list[float]]:
    """Return the points of a path [m], rounded to 0.1 mm.

    `name` is a file with points, or a recording: its path, its name or `last`. The points of a
    recording are its last motion; `frame` applies to these alone.

    Raises:
        UsageError: There is no such file.
        Refused: `name` is `last`, and the robot has no recording.
        UnreadableFile: The file holds no path, or more than a path may have.
    """
    if name == LAST and not os.path.exists(name):
        points: Iterable[Point] = last_path(robot, frame)
    else:
        path = find_recording(name, robot)
        data = _content(name, path)
        if data is None or data.startswith(MCAP):
            points = driven_path(path, frame, partial(_note, path))
            if not points:
                raise UnreadableFile(f"{path} holds no path: its robot did not drive")
        else:
            points = _points_in(printable(name), data)
    return [[round(x, 4), round(y, 4)] for x, y in points]


def _content(name: str, path: Path) -> bytes | None:
    """Return at most MAX_BYTES + 1 bytes of a file, or None for a folder."""
    try:
        if path.is_dir():
            return None
        with open_regular(path) as file:
            return file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise UsageError(f"no file {printable(name)}", KINDS) from None
    except OSError as error:
        raise UnreadableFile(f"{printable(name)}: {error.strerror}") from None


def _points_in(name: str, data: bytes) -> list[Point]:
    if len(data) > MAX_BYTES:
        raise UnreadableFile(f"{name} is too large: a path has at most {MAX_POINTS} points")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UnreadableFile(f"{name} holds no path: {KINDS}") from None
    lines = text.splitlines()
    is_csv = bool(lines) and lines[0].replace(" ", "").lower() == "x,y"
    rows = list(_csv_rows(lines) if is_csv else _yaml_rows(name, text))
    if not 2 <= len(rows) <= MAX_POINTS:
        points = f"{len(rows)} point{'' if len(rows) == 1 else 's'}"
        raise UnreadableFile(f"{name} has {points}: a path has 2 to {MAX_POINTS}")
    return [_point(name, number, row) for number, row in enumerate(rows, 1)]


def _csv_rows(lines: list[str]) -> Iterator[_WrittenPoint]:
    reader = csv.reader(lines)
    for values in reader:
        stripped = [value.strip() for value in values]
        if reader.line_num > 1 and stripped not in ([], [""]):
            yield _WrittenPoint(stripped, reader.line_num, ",".join(values))


def _yaml_rows(name: str, text: str) -> Iterator[_WrittenPoint]:
    """Yield the points of a YAML list in their original text."""
    import yaml  # here: the import takes 20 ms

    try:
        root = yaml.compose(text, yaml.SafeLoader)  # the loader in C crashes on deep nesting
    except (yaml.YAMLError, ValueError, RecursionError):
        root = None
    if not isinstance(root, yaml.SequenceNode):
        raise UnreadableFile(f"{name} holds no path: {KINDS}")
    for node in root.value:
        shown = text[node.start_mark.index : node.end_mark.index]
        yield _WrittenPoint(_yaml_values(node), node.start_mark.line + 1, shown)


def _yaml_values(node: yaml.Node) -> list[str]:
    """Return the plain scalars of [x, y] or {x: X, y: Y}, [] for anything else."""
    parts: list[Any] = []
    if node.tag == "tag:yaml.org,2002:seq":
        parts = node.value
    elif node.tag == "tag:yaml.org,2002:map":
        named = {key.value: value for key, value in node.value if isinstance(key.value, str)}
        parts = [named["x"], named["y"]] if named.keys() == {"x", "y"} else []
    is_plain = all(isinstance(part.value, str) and part.style is None for part in parts)
    return [part.value for part in parts] if is_plain else []


def _point(name: str, number: int, row: _WrittenPoint) -> Point:
    if len(row.values) == 2 and all(map(_NUMBER.fullmatch, row.values)):
        x, y = map(float, row.values)
        if max(abs(x), abs(y)) <= MAX_COORDINATE_M:
            return x, y
    raise UnreadableFile(
        f"{name}, line {row.line}: point {number} is {printable(row.text[:MAX_SHOWN])}: "
        f"a point is two numbers up to {MAX_COORDINATE_M:g} [m]"
    )


def last_path(robot: str, frame: Frame) -> tuple[Point, ...]:
    """Return the points of the last motion in the newest recording with a drive.

    A running daemon first commits its recording. A note on stderr names an older recording.

    Raises:
        Refused: The robot has no recording.
        UnreadableFile: None of the last recordings has a drive, or a recording is unreadable.
    """
    missing: list[str] = []
    newest = committed_recording(robot, missing) or find_recording(LAST, robot)
    for sentence in missing:
        _note(newest, sentence)
    paths = with_earlier(newest)
    for path in paths:
        points = driven_path(path, frame, partial(_note, path))
        if points:
            if path != newest:
                _note(path, "the newest recording in which the robot drove")
            return points
    before = f" and {len(paths) - 1} before it" if len(paths) > 1 else ""
    raise UnreadableFile(f"{newest}{before}: the robot did not drive")


def _note(path: Path, sentence: str) -> None:
    print(f"note: {printable(short_path(path))}: {printable(sentence)}", file=sys.stderr)


PATH_TYPE: Final = "nav_msgs/msg/Path"

MAX_MESSAGE_BYTES: Final = 512 * MAX_POINTS
"""Limit on a serialized path [bytes]; a pose has about 100 bytes."""

NOTE_S: Final = 2.0
"""The time without a message before a note on stderr [s]."""

ODOMETRY_FRAME: Final = "odom"
"""The frame of odometry (REP 105), unless `odometry.frame_id` names another."""


def heard_path(robot: str, topic: str) -> tuple[str, list[list[float]], Frame]:
    """Wait for the next path on a topic; return the topic's full name, the points [m], the frame.

    Raises:
        Refused: The message holds no path, too many points, or is in an unknown frame.
    """
    listed = call(robot, PARAM_LIST)["parameters"]
    parameters: dict[str, Any] = {each["key"]: each["value"] for each in listed}
    frames = {
        str(parameters["odometry.frame_id"] or ODOMETRY_FRAME): Frame.ODOM,
        str(parameters["command.frame_id"]): Frame.START,
    }
    view = ros_view(robot, None)
    name = view.full_name(topic)
    with view.listen(name, PATH_TYPE, data=True) as listener:
        definition = parse_definition(listener.type_name, listener.definition)
        while not (messages := list(listener.receive(NOTE_S))):
            print(f"robotctl: no path on {printable(name)} yet. Ctrl-C ends", file=sys.stderr)
    points, frame = path_in(definition, base64.b64decode(messages[-1]["data"]), frames, name)
    return name, points, frame


def path_in(
    definition: Definition, data: bytes, frames: Mapping[str, Frame], name: str
) -> tuple[list[list[float]], Frame]:
    """Return points [m] and frame of the path message `data`; `frames` has frames by frame_id.

    Raises:
        Refused: The message is unreadable or in another frame, or its points are not allowed.
    """
    shown = printable(name)
    if len(data) > MAX_MESSAGE_BYTES:
        raise Refused(f"the path on {shown} is too large: it has at most {MAX_POINTS} points")
    try:
        message = Decoder(definition).values(data)
    except struct.error:
        raise Refused(f"the message on {shown} cannot be read") from None
    poses = message["poses"]
    if not 2 <= len(poses) <= MAX_POINTS:
        told = f"{len(poses)} point{'' if len(poses) == 1 else 's'}"
        problem = f"the path on {shown} has {told}"
        raise Refused(problem, f"a path has 2 to {MAX_POINTS}")
    frame_id = message["header"]["frame_id"]
    named = {frame_id, *(pose["header"]["frame_id"] or frame_id for pose in poses)}
    if len(named) > 1 or frame_id not in frames:
        told = " and ".join(f"frame {printable(each)!r}" for each in sorted(named)[:2])
        cure = f"publish it in {' or '.join(map(printable, frames))}"
        raise Refused(f"the path on {shown} is in {told}", cure)
    points = []
    for number, pose in enumerate(poses, 1):
        place = pose["pose"]["position"]
        if not (isfinite(place["x"]) and isfinite(place["y"])):
            raise Refused(f"point {number} of the path on {shown} is {place['x']}, {place['y']}")
        points.append([round(place["x"], 4), round(place["y"], 4)])
    return points, frames[frame_id]
