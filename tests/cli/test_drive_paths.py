"""Paths to drive from CSV, YAML, messages and recordings; anything else is named."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import Refused, UnreadableFile, UsageError
from robotctl.check.driven_path import simplified
from robotctl.cli.commands.drive_paths import PATH_TYPE, path_in, read_waypoints
from robotctl.kernel.course import MAX_POINTS, Course, Frame, Point
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern, PatternKind, path_of
from robotctl.kernel.types import DriveRequested, ModeRequested
from robotctl.messages.definition import parse_definition
from robotctl.messages.installed import installed_type
from robotctl.messages.values import encode
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.testing.drives import BEGIN_NS, Written, drive, drive_requested, record
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
    assert read_waypoints(written(tmp_path, text), Frame.START, "robot") == CORNER


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


def test_a_missing_file_a_fifo_and_a_folder_without_a_recording_are_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no file"):
        read_waypoints(str(tmp_path / "none.csv"), Frame.START, "robot")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(UnreadableFile, match="regular file"):
        read_waypoints(str(tmp_path / "fifo"), Frame.START, "robot")
    with pytest.raises(UnreadableFile, match=r"holds no \.mcap file"):
        read_waypoints(str(tmp_path), Frame.START, "robot")


FRAMES = {"odom": Frame.ODOM, "base_link": Frame.START}

DEFINITION = parse_definition(PATH_TYPE, installed_type(PATH_TYPE).text)


def header(frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": frame}


def message(points: list[tuple[float, float]], frame: str = "odom", each: str = "") -> bytes:
    turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    places = ({"position": {"x": x, "y": y, "z": 0.0}, "orientation": turned} for x, y in points)
    poses = [{"header": header(each), "pose": place} for place in places]
    return encode(DEFINITION, {"header": header(frame), "poses": poses})


@pytest.mark.parametrize(("frame", "meant"), [("odom", Frame.ODOM), ("base_link", Frame.START)])
def test_the_points_are_those_of_the_poses_in_their_frame(frame: str, meant: Frame) -> None:
    data = message([(0.0, 0.0), (1.00004, -2.5)], frame, each=frame)
    assert path_in(DEFINITION, data, FRAMES, "/plan") == ([[0.0, 0.0], [1.0, -2.5]], meant)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (message([(0.0, 0.0)]), "has 1 point: a path has 2 to 2000"),
        (message([]), "has 0 points"),
        (message([(float(n), 0.0) for n in range(MAX_POINTS + 1)]), "has 2001 points"),
        (bytes(1_000_000 * 100), "too large: it has at most 2000 points"),
        (message([(0.0, 0.0), (nan, 1.0)]), "point 2 of the path on /plan is nan, 1.0"),
        (message([(0.0, 0.0), (1.0, inf)]), "point 2 of"),
        (message([(0.0, 0.0), (1.0, 0.0)], "map"), "in frame 'map': publish it in odom or base_"),
        (message([(0.0, 0.0), (1.0, 0.0)], ""), "is in frame ''"),
        (message([(0.0, 0.0), (1.0, 0.0)], "odom", "map"), "in frame 'map' and frame 'odom'"),
        (message([(0.0, 0.0), (1.0, 0.0)])[:-9], "cannot be read"),
        (b"", "cannot be read"),
    ],
)
def test_what_cannot_be_driven_is_named(data: bytes, said: str) -> None:
    with pytest.raises(Refused) as refused:
        path_in(DEFINITION, data, FRAMES, "/plan")
    assert said in str(refused.value)


def points_of(name: str, robot: str = "robot") -> tuple[Point, ...]:
    return tuple((x, y) for x, y in read_waypoints(name, Frame.START, robot))


@pytest.fixture(scope="module")
def standing() -> list[Written]:
    return drive(1.0, requests=())


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
    points = points_of(str(recorded))
    assert len(points) <= 40
    result = drive_simulated(Pattern(), course=Course(waypoints=points))
    assert result.ended.completed
    assert result.ended.report.cross_track_max_m <= 0.03
    # Off the circle itself at most that, and what the waypoints leave out.
    circle = path_of(Pattern(PatternKind.CIRCLE, 0.5), Course())
    for x, y in points:
        assert circle.distance_to(Pose(x, y), 0, 0.0) <= 0.03
    outline = path_of(Pattern(), Course(waypoints=points), again=False).outline()
    assert max(circle.distance_to(pose, 0, 0.0) for pose in outline) <= 0.04


def test_the_path_of_a_motion_in_reverse_is_driven_again_in_reverse(tmp_path: Path) -> None:
    line, reverse = Pattern(PatternKind.LINE, 0.5), Course(reverse=True)
    asked = DriveRequested(BEGIN_NS + 100_000_000, 1, line, 1, False, "test", course=reverse)
    folder = record(tmp_path / "robot_20260101_120000", drive(3.0, requests=[asked]))
    points = points_of(str(folder))
    result = drive_simulated(Pattern(), course=replace(reverse, waypoints=points))
    assert result.pose.distance(Pose(-0.5, 0.0)) <= 0.05
    assert max(abs(command.angular) for command in result.commands) <= 0.5


def test_a_recording_without_motion_holds_no_path(standing: list[Written]) -> None:
    folder = record(Path("robot_20260101_120000"), standing)
    with pytest.raises(UnreadableFile, match="did not drive"):
        points_of(str(folder))


def test_the_last_path_is_that_of_the_robot_in_the_newest_recording_in_which_it_drove(
    recorded: Path, standing: list[Written], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path("recordings")
    shutil.copytree(recorded, folder / "robot_20260101_120000")
    record(folder / "robot_20260102_120000", standing)
    line = DriveRequested(BEGIN_NS + 1, 1, Pattern(PatternKind.LINE, 0.5), 1, False, "test")
    record(folder / "other_20260103_120000", drive(3.0, requests=[line]))
    assert points_of("last") == points_of(str(recorded))
    assert "robot_20260101_120000: the newest recording in which" in capsys.readouterr().err
    assert len(points_of("last", "other")) == 2
    assert not capsys.readouterr().err
    with pytest.raises(Refused, match="no recording of robot 'third'"):
        points_of("last", "third")


def test_a_motion_that_did_not_end_is_no_path() -> None:
    folder = record(Path("robot_20260101_120000"), drive(3.0))
    with pytest.raises(UnreadableFile, match="only a part of its last motion: it ends while"):
        points_of(str(folder))


def test_a_motion_whose_begin_is_not_recorded_is_no_path() -> None:
    stop = ModeRequested(BEGIN_NS + 2_000_000_000, 2, Mode.IDLE, "test")
    written = drive(3.0, requests=[drive_requested(), stop], snapshots_s=(0.0, 1.0))
    snapshots = [
        number
        for number, each in enumerate(written)
        if isinstance(each, JournalEntry) and each.kind is EntryKind.SNAPSHOT
    ]
    folder = record(Path("robot_20260101_120000"), written[snapshots[1] :])
    with pytest.raises(UnreadableFile, match="only a part of its last motion"):
        points_of(str(folder))


def test_a_motion_with_a_hole_is_no_path() -> None:
    stop = ModeRequested(BEGIN_NS + 2_000_000_000, 2, Mode.IDLE, "test")
    written = drive(3.0, requests=[drive_requested(), stop])
    del written[len(written) // 3 : len(written) // 3 + 20]
    folder = record(Path("robot_20260101_120000"), written)
    with pytest.raises(UnreadableFile, match="the journal lacks"):
        points_of(str(folder))


@pytest.mark.parametrize(("share", "is_whole"), [(0.3, False), (0.9, True)])
def test_of_a_damaged_recording_only_a_whole_motion_is_a_path(
    recorded: Path, capsys: pytest.CaptureFixture[str], share: float, is_whole: bool
) -> None:
    (file,) = recorded.glob("*.mcap")
    data = file.read_bytes()
    Path("cut.mcap").write_bytes(data[: round(share * len(data))])
    if is_whole:
        assert points_of("cut.mcap") == points_of(str(recorded))
        assert "note: cut.mcap: bytes" in capsys.readouterr().err
    else:
        with pytest.raises(UnreadableFile, match="only a part of its last motion: bytes"):
            points_of("cut.mcap")


def test_simplified_points_keep_within_the_tolerance() -> None:
    line = [(0.01 * number, 0.004 * (number % 2)) for number in range(101)]
    assert len(simplified(line, 0.005)) == 2
    assert len(simplified(line, 0.001)) > 90
    there_and_back = ((0.0, 0.0), (3.0, 0.0), (0.0, 0.0))
    assert simplified(there_and_back, 0.005) == there_and_back
