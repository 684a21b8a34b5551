"""The points of a path are read from CSV and YAML; anything else is named."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robotctl.base.errors import UnreadableFile, UsageError
from robotctl.cli.commands.drive.paths import read_waypoints
from robotctl.kernel.course import MAX_POINTS, Course, Frame
from robotctl.kernel.patterns import Pattern, path_of

CORNER = [[0.0, 0.0], [1.0, 0.0], [1.0, 2.5]]


def written(tmp_path: Path, text: str | bytes) -> str:
    path = tmp_path / "points"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


@pytest.mark.parametrize(
    "text",
    [
        "x,y\n0,0\n1,0\n1,2.5\n",
        "X, Y\r\n0, 0\r\n\r\n1, 0\r\n1, 2.5",
        "\ufeffx,y\n0,0\n1.00001,0\n1e0,2.5\n",
        "- [0, 0]\n- [1, 0]\n- [1.0, 2.5]\n",
        "[{x: 0, y: 0}, {x: 1, y: 0}, {x: 1, y: 2.5}]",
    ],
)
def test_csv_and_yaml_are_read(tmp_path: Path, text: str) -> None:
    assert read_waypoints(written(tmp_path, text), Frame.START, "robot") == CORNER


def test_a_file_that_repeats_its_points_leads_the_same_way(tmp_path: Path) -> None:
    rows = "".join(f"{x},{y}\n" * 3 for x, y in CORNER)
    points = read_waypoints(written(tmp_path, "x,y\n" + rows), Frame.START, "robot")
    assert len(points) == 3 * len(CORNER)
    again, once = (Course(waypoints=tuple((x, y) for x, y in each)) for each in (points, CORNER))
    assert path_of(Pattern(), again) == path_of(Pattern(), once)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x,y\n1,2\n", "has 1 point: a path has 2"),
        ("x,y\n" + "1,2\n" * (MAX_POINTS + 1), f"a path has 2 to {MAX_POINTS}"),
        ("x,y\n" + "1.25,2.25\n" * 1_000_000, "too large"),
        ("x,y\n0,0\nnan,1\n", "point 2 is"),
        ("x,y\n0,0\n1,inf\n", "point 2 is"),
        ("x,y\n0,0\n1\n", "point 2 is"),
        ("x,y\n0,0\n1,2,3\n", "point 2 is"),
        ("x,y\n0,0\nhere,there\n", "point 2 is"),
        ("x,y\n0,0\n\x1b[31m,1\n", r"point 2 is"),
        ("- [0, 0]\n- {x: 1}\n", "point 2 is"),
        ("- [0, 0]\n\n- [1, b]\n", r"line 3: point 2 is \[1, b\]: a point is two numbers"),
        ("x,y\n\n0,0\n  \n1,z\n", "line 5: point 2 is 1,z: a point is two numbers"),
        ("x,y\n0,0\n,\n1,1\n", "point 2 is"),
        ("x,y\n0,0\n10001,0\n", "point 2 is 10001,0: a point is two numbers up to 10000"),
        ("1,2\n3,4\n", "holds no path"),
        ("[" * 500, "holds no path"),
        ("", "holds no path"),
        (b"\x89PNG\r\n\x1a\n\x00\xff", "holds no path"),
        (b"\x89MCAP0\r\n", "cannot be read: it ends at byte 8, in the middle of a record"),
        (b"\x89MCAP0\r\n" + bytes(100), "cannot be read: it does not begin with a header"),
    ],
)
def test_what_is_no_path_is_named(tmp_path: Path, text: str | bytes, said: str) -> None:
    with pytest.raises(UnreadableFile, match=said) as failed:
        read_waypoints(written(tmp_path, text), Frame.START, "robot")
    assert "\x1b" not in str(failed.value)


@pytest.mark.parametrize(
    "text",
    [
        '["00", "01"]',
        "[{1: a, 2: b}, {0: c, 1: d}]",
        "[[0, 0], [true, false]]",
        "[[0, 0], [1:30, 0]]",
        "[[0, 0], [0x10, 0]]",
        "[[0, 0], [1_0, 0]]",
        "[[0, 0], ['1', 0]]",
        "[[0, 0], [2026-01-01, 0]]",
        "[[0, 0], !!python/tuple [1, 0]]",
        "[[0, 0], {x: 0, y: [1]}]",
        "x,y\n0,0\n0_3,0\n",
        "x,y\n0,0\n0x1,0\n",
        "x,y\n0,0\n\u0661,0\n",
    ],
)
def test_only_decimal_numbers_are_coordinates(tmp_path: Path, text: str) -> None:
    with pytest.raises(UnreadableFile, match=r"point [12] is"):
        read_waypoints(written(tmp_path, text), Frame.START, "robot")


def nested_aliases(levels: int) -> str:
    """Return a point that is a tree of 10 to the power of `levels` values."""
    anchors = [f"  - &a{level} [{','.join([f'*a{level - 1}'] * 10)}]" for level in range(1, levels)]
    return "\n".join([f"- - &a0 [{','.join('0' * 10)}]", *anchors, "- [0, 0]"])


@pytest.mark.parametrize(
    "text",
    [
        nested_aliases(30),
        f"[[0, 0], [0x{'f' * 5000}, 0]]",
        f"[[0, 0], [{'9' * 5000}, 0]]",
        "&a [*a, *a]",
        "[[0, 0], [0, &a [*a]]]",
    ],
)
def test_a_point_that_means_much_more_than_is_written_is_named_in_a_short_line(
    tmp_path: Path, text: str
) -> None:
    with pytest.raises(UnreadableFile, match=r"point [12] is") as failed:
        read_waypoints(written(tmp_path, text), Frame.START, "robot")
    assert len(str(failed.value)) < len(str(tmp_path)) + 200


def test_a_point_may_be_an_alias_of_another_one(tmp_path: Path) -> None:
    points = read_waypoints(written(tmp_path, "[&a [0, 0], [1, 0], *a]"), Frame.START, "robot")
    assert points == [[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]]


def test_a_missing_file_a_fifo_and_a_folder_without_a_recording_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no file"):
        read_waypoints(str(tmp_path / "none.csv"), Frame.START, "robot")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(UnreadableFile, match="regular file"):
        read_waypoints(str(tmp_path / "fifo"), Frame.START, "robot")
    with pytest.raises(UnreadableFile, match=r"holds no \.mcap file"):
        read_waypoints(str(tmp_path), Frame.START, "robot")
