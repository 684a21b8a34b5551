"""Recordings show which entries the journal of decisions must hold, whatever times it tells."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.paths import make_private, seal_folder
from robotctl.decisions import journal as files
from robotctl.decisions import log as writer
from robotctl.decisions.journal import (
    DecisionKind,
    files_of,
    hash_of,
    head_of,
    log_folder,
    read_log,
)
from robotctl.decisions.log import DecisionLog
from robotctl.kernel.units import DAY_S, NS_PER_S
from robotctl.recording import Recorder, RecorderOptions, Topic, read_info
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.seal.keyring import Keyring

Cli = Callable[..., Any]

DAY_NS = round(DAY_S * NS_PER_S)
NOW_NS = time.time_ns()
YEAR_2100_NS = 4_102_444_800 * NS_PER_S
NAMES = ("robot_20260101_120000", "robot_20260102_120000", "robot_20260103_120000")


@pytest.fixture
def journal(monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the journal, whose files hold few entries."""
    monkeypatch.setattr(writer, "END_S", 30.0)
    monkeypatch.setattr(files, "FILE_BYTES", 250)
    monkeypatch.setattr(writer, "FILE_BYTES", 250)
    return log_folder("robot")


def make(journal: Path, runs: Path, days_ago: tuple[float, ...], keep_years: float = 5.0) -> None:
    """Let a daemon record, stop once and end, so many days ago each."""
    keys = Keyring(make_private(seal_folder("robot")), "robot")
    for name, days in zip(NAMES, days_ago, strict=True):
        now_ns = NOW_NS - round(days * DAY_NS)
        noted = {
            "robot": "robot",
            "decisions": head_of(journal),
            "parameter.decisions.keep_years": str(keep_years),
        }
        recorder = Recorder(
            runs / name,
            RecorderOptions(sealer=keys),
            metadata=lambda noted=noted: noted,  # type: ignore[misc]
            on_failure=pytest.fail,
        )
        number = recorder.add_topic(Topic("/mark", "std_msgs/msg/Empty"))
        recorder.write(number, bytes(4), now_ns, now_ns, 1, bytes(16))
        log = DecisionLog(journal, 0.0, now_ns=lambda now_ns=now_ns: now_ns)  # type: ignore[misc]
        log.add(DecisionKind.START, by="ada", version="1", recording=str(runs / name))
        log.add_values(DecisionKind.MODE, {"from": "MOVING", "to": "EMERGENCY_STOP"})
        log.add(DecisionKind.END)
        log.close()
        recorder.close()


def rewrite(journal: Path, keep: Callable[[bytes], bool], first_ns: int | None = None) -> None:
    """Leave entries out, and make the chain right again."""
    prev = ""
    for path in files_of(journal):
        lines = []
        for line in filter(keep, path.read_bytes().splitlines()):
            entry = json.loads(line) | {"prev": prev}
            if first_ns is not None and not prev:
                entry["time_ns"] = first_ns
            lines.append(json.dumps(entry, separators=(",", ":")).encode())
            prev = hash_of(lines[-1])
        path.write_bytes(b"".join(line + b"\n" for line in lines))
    assert read_log(journal).broken == []


def times_of(path: Path) -> list[int]:
    return [json.loads(line)["time_ns"] for line in path.read_bytes().splitlines()]


def report(cli: Cli, *options: str, exit_code: int = 0) -> Any:
    ran = cli("evidence", "--no-check", "--json", *options)
    assert ran.exit_code == exit_code, ran
    return json.loads(ran.out)


@pytest.mark.parametrize("first_ns", [None, 0, YEAR_2100_NS])
def test_a_journal_that_was_made_again_without_its_stops_exits_with_7(
    journal: Path, tmp_path: Path, cli: Cli, first_ns: int | None
) -> None:
    make(journal, tmp_path / "runs", (3, 2, 1))
    assert len(report(cli)["stops"]) == 3
    rewrite(journal, lambda line: b"EMERGENCY_STOP" not in line, first_ns)
    found = report(cli, exit_code=7)
    assert [each["named"] for each in found["recordings"]] == [True] * 3
    assert "knows an entry that is not there" in found["journal"]["broken"][0]


def test_recordings_whose_entries_were_removed_are_told_all_the_same(
    journal: Path, tmp_path: Path, cli: Cli
) -> None:
    make(journal, tmp_path / "runs", (3, 2, 1))
    rewrite(journal, lambda line: NAMES[2].encode() in line)
    found = report(cli, exit_code=7)
    named = [(Path(each["path"]).name, each["named"]) for each in found["recordings"]]
    assert named == [(NAMES[2], True), (NAMES[0], False), (NAMES[1], False)]


def test_entries_that_are_older_than_they_are_kept_are_not_missed(
    journal: Path, tmp_path: Path, cli: Cli
) -> None:
    year = 365.25
    make(journal, tmp_path / "runs", (9 * year, 8 * year, year))
    oldest_ns = NOW_NS - 5 * year * DAY_NS
    removed = [path for path in files_of(journal) if times_of(path)[-1] < oldest_ns]
    for path in removed:
        path.unlink()
    second = read_info(tmp_path / "runs" / NAMES[1]).metadata[INFO_RECORD]
    assert second["decisions"] not in read_log(journal).heads
    assert times_of(files_of(journal)[0])[0] < oldest_ns
    found = report(cli)
    assert found["journal"]["broken"] == []


def test_a_recording_that_retention_did_not_remove_is_missing(
    journal: Path, tmp_path: Path, cli: Cli
) -> None:
    make(journal, tmp_path / "runs", (3, 2, 1))
    log = DecisionLog(journal, 0.0)
    log.add(DecisionKind.REMOVED, file=str(tmp_path / "runs" / NAMES[0] / f"{NAMES[0]}_0.mcap"))
    log.close()
    for name in NAMES[:2]:
        shutil.rmtree(tmp_path / "runs" / name)
    states = [each["state"] for each in report(cli)["recordings"]]
    assert states == ["removed", "missing", "there"]


def test_since_asks_the_recordings_for_their_times_and_not_the_journal_alone(
    journal: Path, tmp_path: Path, cli: Cli
) -> None:
    make(journal, tmp_path / "runs", (3, 2, 1))
    for path in files_of(journal):  # as if all entries were from 1970
        lines = [json.loads(line) | {"time_ns": 1} for line in path.read_bytes().splitlines()]
        path.write_bytes(b"".join(json.dumps(line).encode() + b"\n" for line in lines))
    found = report(cli, "--since", "60h", exit_code=7)
    assert [Path(each["path"]).name for each in found["recordings"]] == list(NAMES[1:])
