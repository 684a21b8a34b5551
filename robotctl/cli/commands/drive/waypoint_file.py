"""The points of a path, from CSV, YAML or a recording."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from math import isfinite
from pathlib import Path
from typing import Any

from robotctl.cli.support.recording_paths import LAST, find_recording
from robotctl.cli.terminal.text import printable
from robotctl.errors import UnreadableFile, UsageError
from robotctl.kernel.course import MAX_POINTS, Frame, Point
from robotctl.regular_file import open_regular

MAX_BYTES = 64 * MAX_POINTS
"""More than any path needs."""

MCAP = b"\x89MCAP0\r\n"

KINDS = "use CSV with the header x,y, YAML with a list of [x, y], or a recording"


def read_waypoints(name: str, frame: Frame) -> list[list[float]]:
    """Return the points of a path in metres, to a tenth of a millimetre.

    Of a recording these are the places of its last motion, relative to where it began, or in the
    frame of odometry.

    Raises:
        UsageError: There is no such file.
        UnreadableFile: The file holds no path, or more than a path may have.
    """
    path = Path(name)
    if name == LAST or path.is_dir():
        points: Iterable[Point] = _recorded(find_recording(name, None), frame)
    else:
        try:
            with open_regular(path) as file:
                data = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            raise UsageError(f"no file {printable(name)}", KINDS) from None
        except OSError as error:
            raise UnreadableFile(f"{printable(name)}: {error.strerror}") from None
        if data.startswith(MCAP):
            points = _recorded(path, frame)
        else:
            points = _points_in(printable(name), data)
    return [[round(x, 4), round(y, 4)] for x, y in points]


def _recorded(recording: Path, frame: Frame) -> tuple[Point, ...]:
    from robotctl.rerun.driven_path import driven_path  # here: other drives read no recording

    return driven_path(recording, frame)


def _points_in(name: str, data: bytes) -> list[Point]:
    if len(data) > MAX_BYTES:
        raise UnreadableFile(f"{name} is too large: a path has at most {MAX_POINTS} points")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise UnreadableFile(f"{name} holds no path: {KINDS}") from None
    lines = text.splitlines()
    if lines and lines[0].replace(" ", "").lower() == "x,y":
        rows: list[Any] = [row for row in csv.reader(lines[1:]) if row]
    else:
        rows = _yaml_rows(name, text)
    if not 2 <= len(rows) <= MAX_POINTS:
        raise UnreadableFile(f"{name} has {len(rows)} points: a path has 2 to {MAX_POINTS}")
    return [_point(name, number, row) for number, row in enumerate(rows, 1)]


def _yaml_rows(name: str, text: str) -> list[Any]:
    import yaml  # here: it takes 20 ms

    try:
        rows = yaml.safe_load(text)  # the loader in C crashes on deep nesting
    except (yaml.YAMLError, ValueError, RecursionError):
        rows = None
    if not isinstance(rows, list):
        raise UnreadableFile(f"{name} holds no path: {KINDS}")
    return rows


def _point(name: str, number: int, row: Any) -> Point:
    """Return the point of a row: two numbers, or a mapping with x and y."""
    if isinstance(row, dict) and row.keys() == {"x", "y"}:
        row = [row["x"], row["y"]]
    try:
        x, y = (float(value) for value in row)
    except (TypeError, ValueError, OverflowError):
        x = y = float("nan")
    if not (isfinite(x) and isfinite(y)):
        shown = printable(str(row))[:60]
        raise UnreadableFile(f"{name}: point {number} is {shown}: a point is two numbers [m]")
    return x, y
