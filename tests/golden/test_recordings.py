"""Recordings of version 0.1.0 are read, told and decided again by this version."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from mcap.reader import make_reader

from robotctl import __version__
from robotctl.check.ends import NOT_PROVED
from robotctl.check.invariants import unbalanced
from robotctl.check.run import check_recording
from robotctl.cli import app
from robotctl.config import Config
from robotctl.daemon.recording.recordings_folder import open_recorder
from robotctl.recording import Recording, read_info, read_messages
from robotctl.recording.format.names import EventKind
from robotctl.recording.format.recorded_events import events_in
from robotctl.recording.format.topics import read_ledger

GOLDEN = Path(__file__).parent
RECORDINGS = ("stopped", "killed", "foreign")
FILES = sorted(path for name in RECORDINGS for path in (GOLDEN / name).glob("*.mcap"))
MAX_BYTES = 300_000

COUNTS = {"stopped": 176, "killed": 121, "foreign": 229}
"""Events in each journal, as version 0.1.0 counted them."""

VERDICTS = tomllib.loads((GOLDEN / "verdicts.toml").read_text())


def test_the_recordings_are_small() -> None:
    assert len(FILES) == 4
    kept = [path for folder in RECORDINGS for path in (GOLDEN / folder).iterdir()]
    assert sum(path.stat().st_size for path in kept) <= MAX_BYTES


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_golden_recording_gets_the_verdict_that_is_written_for_it(name: str) -> None:
    report = check_recording(GOLDEN / name)
    assert (report.version, report.events) == ("0.1.0", COUNTS[name])
    assert report.violations == []
    assert NOT_PROVED in report.notes
    written = VERDICTS[name]
    assert report.verdict == written["verdict"]
    rules = f"decided by the rules of another version (0.1.0, this is {__version__}): "
    for said, expected in zip(report.missing, written["missing"], strict=True):
        assert said.startswith(rules + expected)


@pytest.mark.parametrize("name", RECORDINGS)
def test_a_golden_recording_is_told(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.run(["info", str(GOLDEN / name), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {topic["name"] for topic in told["topics"]} >= {
        "/cmd_vel",
        "/odom",
        "/robot_status",
        "/robotctl/journal",
    }


@pytest.mark.parametrize(
    ("name", "at", "what"),
    [
        ("stopped", "2026-11-22T04:15:23.6Z", "MOVING -> EMERGENCY_STOP: requested by"),
        ("stopped", "last", "MOVING -> IDLE: requested by robotctl set-mode"),
        ("foreign", "last", "MOVING -> ERROR: /somebody_else also publishes"),
    ],
)
def test_why_explains_what_stopped_a_golden_recording(
    name: str, at: str, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    chosen = [] if at == "last" else ["--at", at]
    assert app.run(["why", str(GOLDEN / name), *chosen]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert what in told
    assert "rule" in told


def test_the_events_in_the_metadata_are_understood() -> None:
    kinds = {}
    for name in RECORDINGS:
        with Recording(GOLDEN / name) as recording:
            kinds[name] = [event.kind for event in events_in(recording.metadata())]
    ended = EventKind.DRIVE_ENDED
    assert kinds == {
        "stopped": [EventKind.EMERGENCY_STOP, ended, ended],
        "killed": [],
        "foreign": [EventKind.ERROR, ended],
    }


def test_the_ledger_of_a_closed_golden_recording_is_balanced() -> None:
    for path, closed in ((FILES[1], True), (FILES[2], False), (FILES[3], True)):
        ledger = read_ledger(read_info(path).metadata)
        assert bool(ledger) is closed, path
        assert list(unbalanced(ledger, finished=True)) == []


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_the_file_format_is_what_other_readers_count_on(path: Path) -> None:
    with path.open("rb") as stream:
        reader = make_reader(stream)
        header, summary = reader.get_header(), reader.get_summary()
        names = {record.name for record in reader.iter_metadata()}
        theirs = sum(1 for _ in reader.iter_messages())
    assert summary is not None
    assert header.profile == "ros2"
    assert header.library == "robotctl 0.1.0"
    assert names - {"robotctl.event", "robotctl.ledger"} == {"robotctl", "rosbag2"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert sum(1 for _ in read_messages(path)) == theirs > 0


def test_this_version_writes_what_the_golden_metadata_has(tmp_path: Path) -> None:
    """Names of records and of facts may be added; none goes away."""
    recorder = open_recorder(
        tmp_path,
        "robot",
        Config(),
        lambda: "IDLE",
        lambda detail: None,
        lambda path: None,
        lambda path: None,
    )
    written = recorder.close().file
    ours, golden = read_info(written), read_info(FILES[1])
    assert (ours.profile, ours.library) == (golden.profile, f"robotctl {__version__}")
    assert set(golden.metadata) - {"robotctl.event"} <= set(ours.metadata)
    assert set(golden.metadata["robotctl"]) <= set(ours.metadata["robotctl"]) | {"git.robotctl"}
