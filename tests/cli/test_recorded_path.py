"""The path that a recorded robot drove is driven again: all of it, and of this robot."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from robotctl.base.errors import Refused, UnreadableFile
from robotctl.cli.commands.drive.paths import read_waypoints
from robotctl.kernel.course import Course, Frame, Point
from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import Pattern, PatternKind, path_of
from robotctl.kernel.types import DriveRequested, ModeRequested
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.driven_path import simplified
from robotctl.testing.drives import BEGIN_NS, Written, drive, drive_requested, record
from robotctl.testing.kernels import drive_simulated


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


def test_a_recording_is_found_by_its_name(recorded: Path) -> None:
    Path("recordings").symlink_to(recorded.parent)
    assert points_of(recorded.name) == points_of(str(recorded))


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


def test_a_robot_that_drove_in_none_of_its_recordings_has_no_last_path(
    standing: list[Written],
) -> None:
    for day in (1, 2):
        record(Path(f"recordings/robot_2026010{day}_120000"), standing)
    with pytest.raises(UnreadableFile, match="0102_120000 and 1 before it: the robot did not"):
        points_of("last")


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
