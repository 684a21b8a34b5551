"""The points of a path, from CSV, YAML or a recording."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from robotctl.cli.support.recording_paths import LAST, find_recording
from robotctl.cli.terminal.text import printable
from robotctl.errors import UnreadableFile, UsageError
from robotctl.kernel.course import MAX_COORDINATE_M, MAX_POINTS, Frame, Point
from robotctl.regular_file import open_regular

if TYPE_CHECKING:
    import yaml

MAX_BYTES = 64 * MAX_POINTS
"""More than any path needs."""

MAX_SHOWN = 60
"""How much of a wrong point is shown."""

MCAP = b"\x89MCAP0\r\n"

KINDS = "use CSV with the header x,y, YAML with a list of [x, y], or a recording"

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""A decimal number. Python and YAML know more: 0_3 and 1:30 are no metres."""


class _WrittenPoint(NamedTuple):
    """A point as it is written: its values, the line of the file, and what stands there."""

    values: list[str]
    line: int
    text: str


def read_waypoints(name: str, frame: Frame, robot: str) -> list[list[float]]:
    """Return the points of a path in metres, to a tenth of a millimetre.

    A recording is a path, a name or `last`, of the robot. Its points are the places of its last
    motion, relative to where that began, or in the frame of odometry.

    Raises:
        UsageError: There is no such file.
        Refused: `name` is `last`, and the robot has no recording.
        UnreadableFile: The file holds no path, or more than a path may have.
    """
    if name == LAST and not os.path.exists(name):
        points: Iterable[Point] = _last(robot, frame)
    else:
        path = find_recording(name, robot)
        data = _content(name, path)
        if data is None or data.startswith(MCAP):
            points = _recorded(path, frame)
        else:
            points = _points_in(printable(name), data)
    return [[round(x, 4), round(y, 4)] for x, y in points]


def _content(name: str, path: Path) -> bytes | None:
    """Return the content of a file, at most a byte more than is allowed; None of a folder."""
    try:
        if path.is_dir():
            return None
        with open_regular(path) as file:
            return file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise UsageError(f"no file {printable(name)}", KINDS) from None
    except OSError as error:
        raise UnreadableFile(f"{printable(name)}: {error.strerror}") from None


def _last(robot: str, frame: Frame) -> tuple[Point, ...]:
    from robotctl.cli.commands.drive.recorded_path import last_path  # here: others read none

    return last_path(robot, frame)


def _recorded(recording: Path, frame: Frame) -> tuple[Point, ...]:
    from robotctl.cli.commands.drive.recorded_path import recorded_path  # here: others read none

    return recorded_path(recording, frame)


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
    """Yield the points of a list in YAML, as they are written: an alias is not followed deeper."""
    import yaml  # here: it takes 20 ms

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
