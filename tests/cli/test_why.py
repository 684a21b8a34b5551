"""`robotctl why`: the explanation, on a terminal and as JSON."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest

from robotctl.kernel.types import ModeRequested
from robotctl.recording import read_info
from robotctl.testing.drives import BEGIN_NS, Written, drive, drive_requested, record
from tests.cli.conftest import Cli, note_recordings

FOLDER = Path("recordings/robot_20260101_120000")


@pytest.fixture(scope="module")
def stopped() -> list[Written]:
    estop = ModeRequested(BEGIN_NS + 2_000_000_000, 2, 3, "robotctl estop\x1b[2J")
    again = ModeRequested(BEGIN_NS + 2_500_000_000, 3, 1, "operator")
    return drive(3.0, requests=[drive_requested(), estop, again])


def test_the_last_recording_is_meant_where_none_is_named(cli: Cli, stopped: list[Written]) -> None:
    record(FOLDER, stopped)
    out = cli("why").succeeded("moving is refused in EMERGENCY_STOP")
    assert out == cli("why", "last").out == cli("why", str(FOLDER)).out
    assert out == cli("why", str(FOLDER.parent)).out


def test_machines_get_the_same_as_an_object(cli: Cli, stopped: list[Written]) -> None:
    record(FOLDER, stopped)
    found = cli("why", "--at", "2.1", "--json").summary
    assert found["kind"] == "stop"
    assert (found["mode_before"], found["mode"]) == ("MOVING", "EMERGENCY_STOP")
    assert found["cause"] == "operator stop"
    assert found["event"].startswith("ModeRequested ")
    assert found["zero_after_ms"] >= 0.0


def test_what_cannot_be_told_has_an_exit_code(cli: Cli) -> None:
    assert cli("why").exit_code == 4
    assert cli("why", "nowhere").exit_code == 6
    record(FOLDER, drive(0.5, requests=[]))
    cli("why").failed(4, "nothing was refused")
    assert cli("why", "--at", "noon").exit_code == 2


LATER = Path("recordings/robot_20260101_130000")


def test_a_stop_is_not_forgotten_at_a_restart(cli: Cli, stopped: list[Written]) -> None:
    record(FOLDER, stopped)
    record(LATER, drive(0.5, requests=[]))
    for arguments in ((), ("last",), ("--recordings", "recordings")):
        cli("why", *arguments).succeeded(
            "moving is refused in EMERGENCY_STOP",
            "a later recording without a stop or a refusal",
            f"recorded in {FOLDER}",
        )
    found = cli("why", "--json").summary
    assert (found["path"], found["later"]) == (str(FOLDER.absolute()), [str(LATER.absolute())])
    cli("why", str(LATER)).failed(4, "nothing was refused")


def test_a_recording_that_cannot_be_read_does_not_hide_the_time_in_one_before_it(
    cli: Cli, stopped: list[Written]
) -> None:
    LATER.mkdir(parents=True)
    cli("why", "--at", "2.1").failed(6, "holds no .mcap file")
    record(FOLDER, stopped)
    at = datetime.fromtimestamp(read_info(FOLDER).start_ns / 1e9 + 2.1, UTC).isoformat()
    for time in ("2.1", at):
        found = cli("why", "--at", time, "--json").summary
        assert (found["path"], found["mode"]) == (str(FOLDER.absolute()), "EMERGENCY_STOP")
        (missing,) = found["missing"]
        assert f"{LATER.name} holds no .mcap file" in missing


def test_a_time_of_day_is_looked_for_in_the_recording_that_holds_it_also_after_midnight(
    cli: Cli, stopped: list[Written]
) -> None:
    begin_ns = read_info(record(Path("begin"), stopped)).start_ns
    begin = datetime.fromtimestamp(begin_ns // 10**9, UTC).astimezone()
    midnight = begin.replace(hour=0, minute=0, second=0)
    to_midnight_ns = round(midnight.timestamp()) * 10**9 - begin_ns
    record(FOLDER, stopped, clock=lambda time_ns: time_ns + to_midnight_ns - 2_200 * 10**6)
    morning_ns = to_midnight_ns + 8 * 3_600 * 10**9
    record(LATER, drive(0.5, requests=[]), clock=lambda time_ns: time_ns + morning_ns)
    for at, kind in (("23:59:59.8", "stop"), ("00:00:00.3", "refusal")):
        found = cli("why", "--at", at, "--json").summary
        assert (found["path"], found["kind"]) == (str(FOLDER.absolute()), kind)


def test_the_recordings_of_the_last_daemon_of_any_robot_are_meant_from_another_folder(
    cli: Cli, stopped: list[Written], tmp_path: Path
) -> None:
    for age_s, robot in ((3_600, "robot"), (60, "r2")):
        folder = tmp_path / robot
        record(folder / f"{robot}_20260101_120000", stopped, robot=robot)
        note = note_recordings(folder, robot)
        begun_s = note.stat().st_mtime - age_s
        os.utime(note, (begun_s, begun_s))
    for command in (["why"], ["info", "last"]):
        last = cli(*command, "--json").summary["path"]
        assert last == str(tmp_path / "r2" / "r2_20260101_120000")
        default = cli(*command, "--robot", "robot", "--json").summary["path"]
        assert default == str(tmp_path / "robot" / "robot_20260101_120000")
