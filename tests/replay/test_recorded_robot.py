"""A recorded robot is shown as it was at that moment."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.geometry import Pose
from robotctl.recording import Recording
from robotctl.replay.recorded_robot import RecordedRobot
from robotctl.replay.timeline import Span
from tests.support.bags import ODOMETRY, START_NS, STATUS, Line, odometry, status, write_bag


@contextmanager
def seen(tmp_path: Path, lines: list[Line], **options: Any) -> Iterator[RecordedRobot]:
    with Recording(write_bag(tmp_path / "run.mcap", lines)) as recording:
        info = recording.info()
        span = Span(info.start_ns + options.get("skip_ms", 0) * 10**6, info.end_ns)
        yield RecordedRobot(recording, span, loop=options.get("loop", False))


@pytest.mark.parametrize("endian", ["<", ">"])
def test_pose_velocity_and_path_are_those_of_the_moment(tmp_path: Path, endian: str) -> None:
    with seen(tmp_path, [odometry(n * 100.0, n * 1.0, endian=endian) for n in range(10)]) as robot:
        robot.advance(350 * 10**6)
        assert robot.pose == Pose(3.0, 6.0, 0.0)
        assert robot.velocity is not None
        assert (robot.velocity.linear, robot.velocity.angular) == (0.25, 0.0)
        assert robot.path == [(float(n), 2.0 * n) for n in range(4)]
        assert robot.mode is None
        assert robot.next_ns == 400 * 10**6


def test_after_an_offset_the_mode_is_known_from_before_and_the_path_begins_there(
    tmp_path: Path,
) -> None:
    lines = [status(0, 3), *(odometry(n * 100.0, n * 1.0) for n in range(10))]
    with seen(tmp_path, lines, skip_ms=500) as robot:
        robot.advance(0)
        assert robot.mode == "EMERGENCY_STOP"
        robot.advance(10**10)
        assert robot.path == [(float(n), 2.0 * n) for n in range(4, 10)]
        assert robot.next_ns is None


def test_a_loop_begins_a_new_path(tmp_path: Path) -> None:
    with seen(tmp_path, [odometry(n * 100.0, n * 1.0) for n in range(5)], loop=True) as robot:
        robot.advance(399 * 10**6)
        assert len(robot.path) == 4
        robot.advance(550 * 10**6)
        assert robot.path == [(1.0, 2.0)]


def test_a_mode_of_another_version_is_shown_by_its_number(tmp_path: Path) -> None:
    with seen(tmp_path, [status(0, 9)]) as robot:
        robot.advance(0)
        assert robot.mode == "mode 9"


@given(st.binary(max_size=900))
def test_no_message_can_break_the_view(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        lines = [
            Line("/odom", ODOMETRY, 0.0, content),
            Line("/robot_status", STATUS, 1.0, content),
        ]
        with seen(Path(folder), lines) as robot:
            robot.advance(START_NS)
