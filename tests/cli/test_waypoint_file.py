"""The points of a path are read from CSV, YAML and recordings; anything else is named."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from robotctl.cli.commands.drive.waypoint_file import read_waypoints
from robotctl.errors import UnreadableFile, UsageError
from robotctl.kernel.course import MAX_POINTS, Course, Frame
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern, PatternKind, path_of
from robotctl.kernel.types import DriveRequested, ModeRequested
from robotctl.rerun.driven_path import driven_path, simplified
from robotctl.testing.drives import BEGIN_NS, drive, record
from robotctl.testing.kernels import drive_simulated

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
    assert read_waypoints(written(tmp_path, text), Frame.START) == CORNER


def test_a_file_that_repeats_its_points_leads_the_same_way(tmp_path: Path) -> None:
    rows = "".join(f"{x},{y}\n" * 3 for x, y in CORNER)
    points = read_waypoints(written(tmp_path, "x,y\n" + rows), Frame.START)
    assert len(points) == 3 * len(CORNER)
    again, once = (Course(waypoints=tuple((x, y) for x, y in each)) for each in (points, CORNER))
    assert path_of(Pattern(), again) == path_of(Pattern(), once)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x,y\n1,2\n", "1 points: a path has 2"),
        ("x,y\n" + "1,2\n" * (MAX_POINTS + 1), f"a path has 2 to {MAX_POINTS}"),
        ("x,y\n" + "1.25,2.25\n" * 1_000_000, "too large"),
        ("x,y\n0,0\nnan,1\n", "point 2 is"),
        ("x,y\n0,0\n1,inf\n", "point 2 is"),
        ("x,y\n0,0\n1\n", "point 2 is"),
        ("x,y\n0,0\n1,2,3\n", "point 2 is"),
        ("x,y\n0,0\nhere,there\n", "point 2 is"),
        ("x,y\n0,0\n\x1b[31m,1\n", r"point 2 is"),
        ("- [0, 0]\n- {x: 1}\n", "point 2 is"),
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
        read_waypoints(written(tmp_path, text), Frame.START)
    assert "\x1b" not in str(failed.value)


def test_a_missing_file_a_fifo_and_a_folder_without_a_recording_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no file"):
        read_waypoints(str(tmp_path / "none.csv"), Frame.START)
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(UnreadableFile, match="regular file"):
        read_waypoints(str(tmp_path / "fifo"), Frame.START)
    with pytest.raises(UnreadableFile, match=r"holds no \.mcap file"):
        read_waypoints(str(tmp_path), Frame.START)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive on a circle, and afterwards a request that moves nothing."""
    begin_ns = BEGIN_NS + 100_000_000
    circle = Pattern(PatternKind.CIRCLE, 0.5)
    asked = (
        DriveRequested(begin_ns, 1, circle, 1, False, "test"),
        DriveRequested(BEGIN_NS + 9_000_000_000, 2, circle, 1, False, "test"),
        ModeRequested(BEGIN_NS + 9_050_000_000, 3, Mode.IDLE, "test"),
    )
    folder = tmp_path_factory.mktemp("recordings") / "robot_20260101_120000"
    return record(folder, drive(9.5, requests=asked))


def test_the_path_of_a_recording_is_driven_again_within_the_same_error(recorded: Path) -> None:
    points = [(x, y) for x, y in read_waypoints(str(recorded), Frame.START)]
    assert len(points) <= 40
    result = drive_simulated(Pattern(), course=Course(waypoints=tuple(points)))
    assert result.ended.completed
    assert result.ended.report.cross_track_max_m <= 0.03
    # Off the circle itself at most that, and what the waypoints leave out.
    circle = path_of(Pattern(PatternKind.CIRCLE, 0.5), Course())
    for x, y in points:
        assert circle.distance_to(Pose(x, y), 0, 0.0) <= 0.03
    outline = path_of(Pattern(), Course(waypoints=tuple(points)), again=False).outline()
    assert max(circle.distance_to(pose, 0, 0.0) for pose in outline) <= 0.04


def test_the_path_of_a_motion_in_reverse_is_driven_again_in_reverse(tmp_path: Path) -> None:
    line, reverse = Pattern(PatternKind.LINE, 0.5), Course(reverse=True)
    asked = DriveRequested(BEGIN_NS + 100_000_000, 1, line, 1, False, "test", course=reverse)
    folder = record(tmp_path / "robot_20260101_120000", drive(3.0, requests=[asked]))
    points = tuple((x, y) for x, y in read_waypoints(str(folder), Frame.START))
    result = drive_simulated(Pattern(), course=replace(reverse, waypoints=points))
    assert result.pose.distance(Pose(-0.5, 0.0)) <= 0.05
    assert max(abs(command.angular) for command in result.commands) <= 0.5


def test_a_recording_without_motion_holds_no_path(tmp_path: Path) -> None:
    folder = record(tmp_path / "robot_20260101_120000", drive(1.0, requests=()))
    with pytest.raises(UnreadableFile, match="did not drive"):
        driven_path(folder, Frame.START)


def test_simplified_points_keep_within_the_tolerance() -> None:
    line = [(0.01 * number, 0.004 * (number % 2)) for number in range(101)]
    assert len(simplified(line, 0.005)) == 2
    assert len(simplified(line, 0.001)) > 90
    there_and_back = ((0.0, 0.0), (3.0, 0.0), (0.0, 0.0))
    assert simplified(there_and_back, 0.005) == there_and_back
