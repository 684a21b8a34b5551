"""`robotctl evidence`: one report from the journal of decisions and the recordings."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl.decisions.journal import DecisionKind, files_of, head_of, log_folder
from robotctl.decisions.log import DecisionLog
from robotctl.recording import Recorder, Topic
from robotctl.testing.drives import drive, record

Cli = Callable[..., Any]

DAY_NS = 86_400 * 10**9
BEGIN_NS = 1_800_000_000 * 10**9


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the robot's journal, which does not exist yet."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("robotctl.decisions.log.END_S", 30.0)
    return log_folder("robot")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recordings") / "robot_20260101_120000", drive(2.0))


@pytest.fixture
def journal(state: Path, recorded: Path) -> Path:
    """The journal of three daemons on three days; the last one records to `recorded`."""
    now = SimpleNamespace(ns=BEGIN_NS)
    log = DecisionLog(state, 0.0, now_ns=lambda: now.ns)

    def start(recording: str, version: str, speed_mps: float) -> None:
        log.add(DecisionKind.START, by="ada", version=version, recording=recording)
        log.add_values(DecisionKind.SOFTWARE, {"robotctl": version, "digest": "d" + version})
        log.add_values(
            DecisionKind.CONFIGURATION, {"limits.linear_mps": speed_mps, "rate_hz": 50.0}
        )

    start("/nowhere/robot_20251230_120000", "1", 0.6)
    log.add(DecisionKind.REFUSED, asked="MOVING", by="a node", answer="no odometry")
    log.add(
        DecisionKind.REMOVED, file="/nowhere/robot_20251230_120000/robot_20251230_120000_0.mcap"
    )
    now.ns += DAY_NS  # the first daemon is killed
    start("/nowhere/robot_20251231_120000", "2", 0.6)
    log.add(DecisionKind.END)
    now.ns += DAY_NS
    start(str(recorded), "2", 0.3)
    log.add_values(
        DecisionKind.MODE,
        {"from": "MOVING", "to": "EMERGENCY_STOP", "reason": "asked by ada", "latched": True},
    )
    log.add(DecisionKind.REQUEST, asked="EMERGENCY_STOP", by="ada", answer="Mode changed")
    log.add_values(
        DecisionKind.MODE,
        {"from": "EMERGENCY_STOP", "to": "IDLE", "reason": "reset by ada", "released": True},
    )
    log.add_values(
        DecisionKind.PARAMETER, {"key": "rate_hz", "from": "50.0", "to": "40.0", "by": "bob"}
    )
    log.add(DecisionKind.END)
    log.close()
    return state


def report(cli: Cli, *options: str, exit_code: int = 0) -> Any:
    ran = cli("evidence", "--json", *options)
    assert ran.exit_code == exit_code, ran
    return json.loads(ran.out)


def test_changes_are_told_with_old_and_new_value_and_author(journal: Path, cli: Cli) -> None:
    found = report(cli, "--no-check")
    (first, second) = found["software_changes"]
    assert (first["first"], second["changed"]) == (
        True,
        {"robotctl": ["1", "2"], "digest": ["d1", "d2"]},
    )
    assert second["by"] == "ada"
    changes = [(each["by"], each["changed"]) for each in found["configuration_changes"]]
    assert changes == [
        ("ada", {}),
        ("ada", {"limits.linear_mps": [0.6, 0.3]}),
        ("bob", {"rate_hz": ["50.0", "40.0"]}),
    ]
    assert found["software"]["robotctl"] == "2"
    assert found["configuration"]["limits.linear_mps"] == 0.3


def test_stops_releases_and_refusals_name_the_recording_that_proves_them(
    journal: Path, recorded: Path, cli: Cli
) -> None:
    found = report(cli, "--no-check")
    ((stop,), (release,), (refusal,)) = found["stops"], found["releases"], found["refusals"]
    assert (stop["latched"], stop["recording"]) == (True, str(recorded))
    assert (release["released"], release["recording"]) == (True, str(recorded))
    assert refusal["recording"] == "/nowhere/robot_20251230_120000"
    ended = [each["ended"] for each in found["daemons"]]
    assert ended == ["killed, or the power was cut", "in order", "in order"]


def test_recordings_that_are_there_get_their_verdicts(
    journal: Path, recorded: Path, cli: Cli
) -> None:
    found = report(cli)
    *gone, there = found["recordings"]
    assert [(each["state"], each["check"]) for each in gone] == [
        ("removed", None),
        ("missing", None),
    ]
    assert (there["path"], there["check"]) == (str(recorded), "same")
    assert there["verify"] in ("whole", "sealed")


def test_since_leaves_out_what_is_older(journal: Path, cli: Cli) -> None:
    found = report(cli, "--no-check", "--since", "2027-01-16T12:00:00+00:00")
    assert (len(found["daemons"]), found["refusals"], len(found["stops"])) == (1, [], 1)
    assert [each["changed"] for each in found["configuration_changes"]] == [
        {"limits.linear_mps": [0.6, 0.3]},
        {"rate_hz": ["50.0", "40.0"]},
    ]


def test_a_changed_recording_exits_with_7(
    journal: Path, recorded: Path, cli: Cli, tmp_path: Path
) -> None:
    (file,) = recorded.glob("*.mcap")
    data = file.read_bytes()
    try:
        file.write_bytes(data[:30] + bytes([data[30] ^ 2]) + data[31:])
        ran = cli("evidence")
    finally:
        file.write_bytes(data)
    assert ran.exit_code == 7
    assert "verify broken" in ran.out


def test_a_changed_journal_exits_with_7(journal: Path, cli: Cli) -> None:
    (path,) = files_of(journal)
    path.write_bytes(path.read_bytes().replace(b'"by":"ada","answer"', b'"by":"eve","answer"'))
    ran = cli("evidence", "--no-check")
    assert ran.exit_code == 7
    assert "does not follow" in ran.out


def test_recordings_that_were_moved_are_found_by_name(
    journal: Path, recorded: Path, cli: Cli, tmp_path: Path
) -> None:
    moved = tmp_path / "archive" / "robot_20251231_120000"
    record(moved, drive(1.0))
    found = report(cli, "--recordings", str(moved.parent))
    assert [each["check"] for each in found["recordings"]] == [None, "same", "same"]


def test_the_text_tells_the_same(journal: Path, cli: Cli) -> None:
    out = cli("evidence", "--no-check").out
    for line in (
        "stops: 1",
        "MOVING -> EMERGENCY_STOP (latched): asked by ada",
        "limits.linear_mps: 0.6 -> 0.3, by ada",
        "MOVING by a node: no odometry",
    ):
        assert line in out


@pytest.mark.parametrize("text", ["yesterday", "-3d", "nand", "1e400d", "12", "", "d"])
def test_a_time_that_is_none_is_refused(journal: Path, cli: Cli, text: str) -> None:
    ran = cli("evidence", f"--since={text}")
    assert ran.exit_code == 2
    assert "30d" in ran.err


def test_a_robot_without_a_journal_is_told_how_to_begin(state: Path, cli: Cli) -> None:
    ran = cli("evidence")
    assert ran.exit_code == 4
    assert "robotctl start" in ran.err


def test_entries_that_are_cut_off_the_end_are_missed_by_the_next_recording(
    state: Path, tmp_path: Path, cli: Cli
) -> None:
    """A daemon notes the newest entry in each file, which the seal covers."""
    later = tmp_path / "recordings" / "robot_20270115_080000"
    later.parent.mkdir()
    log = DecisionLog(state, 0.0, now_ns=lambda: BEGIN_NS)
    log.add(DecisionKind.START, by="ada", version="1", recording=str(later))
    log.add(DecisionKind.REFUSED, asked="MOVING", by="a node", answer="no odometry")
    log.close()
    noted = {"robot": "robot", "decisions": head_of(state)}
    recorder = Recorder(later, metadata=lambda: noted, on_failure=pytest.fail)
    number = recorder.add_topic(Topic("/mark", "std_msgs/msg/Empty"))
    recorder.write(number, bytes(4), BEGIN_NS + 1, BEGIN_NS + 1, 1, bytes(16))
    recorder.close()
    assert report(cli, "--no-check")["journal"]["broken"] == []
    later.rename(later.with_name("robot_20270116_080000"))  # as if its start were cut off, too
    (path,) = files_of(state)
    path.write_bytes(path.read_bytes().splitlines(keepends=True)[0])
    told = report(cli, "--no-check", exit_code=7)
    (sentence,) = told["journal"]["broken"]
    assert sentence.startswith("robot_20270116_080000 knows an entry that is not there")
