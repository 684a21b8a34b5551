"""`evidence`: one report from the journal of decisions and the recordings that show it whole."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl.base.errors import UnreadableFile
from robotctl.base.paths import seal_folder
from robotctl.decisions import journal as files
from robotctl.decisions import log as writer
from robotctl.decisions.journal import DecisionKind, files_of, head_of, log_folder, read_log
from robotctl.decisions.log import DecisionLog
from robotctl.kernel.constants import NS_PER_S
from robotctl.recording import Recorder, RecorderOptions, Topic, read_info
from robotctl.recording.format.names import INFO_RECORD
from robotctl.recording.keep.recover import recover
from robotctl.recording.seal import Keyring
from robotctl.testing.drives import drive, record
from tests.cli.conftest import Cli
from tests.support.edited_recordings import contents_of, write_contents
from tests.support.recordings import flip, keyring
from tests.support.waiting import until

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
    """The journal of three daemons on three days; the last one records to `recorded`.

    A line about a sealed file signs it.
    """
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
    Keyring(seal_folder("robot"), "robot").open_file("later")
    return state


def report(cli: Cli, *options: str, exit_code: int = 0) -> Any:
    ran = cli("evidence", "--json", *options)
    assert ran.exit_code == exit_code, ran
    return ran.summary


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


def test_recordings_that_are_there_get_verdicts(journal: Path, recorded: Path, cli: Cli) -> None:
    found = report(cli)
    *gone, there = found["recordings"]
    assert [(each["state"], each["check"]) for each in gone] == [
        ("removed", None),
        ("missing", None),
    ]
    assert (there["path"], there["check"]) == (str(recorded), "same")
    assert there["verify"] in ("whole", "sealed")


def test_a_changed_recording_exits_with_7(journal: Path, recorded: Path, cli: Cli) -> None:
    (file,) = recorded.glob("*.mcap")
    flip(file, 30, 2)
    ran = cli("evidence")
    flip(file, 30, 2)  # as it was
    ran.failed(7, out="verify broken")


def test_a_changed_journal_exits_with_7(journal: Path, cli: Cli) -> None:
    (path,) = files_of(journal)
    path.write_bytes(path.read_bytes().replace(b'"by":"ada","answer"', b'"by":"eve","answer"'))
    cli("evidence", "--no-check").failed(7, out="does not sign the lines before it")


def test_recordings_that_were_moved_are_found_by_name(
    journal: Path, recorded: Path, cli: Cli, tmp_path: Path
) -> None:
    moved = tmp_path / "archive" / "robot_20251231_120000"
    record(moved, drive(1.0))
    found = report(cli, "--no-check", "--recordings", str(moved.parent))
    assert [each["state"] for each in found["recordings"]] == ["removed", "there", "there"]


def test_a_robot_without_a_journal_is_told_how_to_begin(state: Path, cli: Cli) -> None:
    cli("evidence").failed(4, "robotctl start")


NOW_NS = time.time_ns()
YEAR_2100_NS = 4_102_444_800 * NS_PER_S
NAMES = ("robot_20260101_120000", "robot_20260102_120000", "robot_20260103_120000")


@pytest.fixture
def small_files(monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the journal, whose files hold few entries."""
    monkeypatch.setattr(writer, "END_S", 30.0)
    monkeypatch.setattr(files, "FILE_BYTES", 250)
    return log_folder("robot")


def make(journal: Path, runs: Path, days_ago: tuple[float, ...]) -> None:
    """Let a daemon record, stop once and end, so many days ago each."""
    for name, days in zip(NAMES, days_ago, strict=True):
        now_ns = NOW_NS - round(days * DAY_NS)
        noted = {"robot": "robot", "decisions": head_of(journal)}
        recorder = Recorder(
            runs / name,
            RecorderOptions(sealer=Keyring(seal_folder("robot"), "robot")),
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


@pytest.mark.parametrize("unwanted", [b"EMERGENCY_STOP", NAMES[2].encode()])
@pytest.mark.parametrize("first_ns", [1, YEAR_2100_NS])
def test_a_journal_that_was_cut_off_or_made_again_exits_with_7(
    small_files: Path, tmp_path: Path, cli: Cli, unwanted: bytes, first_ns: int
) -> None:
    """A daemon notes the newest lines in each file, which the seal covers."""
    make(small_files, tmp_path / "runs", (3, 2, 1))
    assert len(report(cli, "--no-check")["stops"]) == 3
    for path in files_of(small_files):
        lines = [
            json.loads(line) for line in path.read_bytes().splitlines() if unwanted not in line
        ]
        lines = [line | {"time_ns": first_ns} for line in lines if "opened" not in line]
        path.write_bytes(b"".join(json.dumps(line).encode() + b"\n" for line in lines))
    found = report(cli, "--no-check", exit_code=7)
    assert len(found["recordings"]) == 3
    assert "knows an entry that is not there" in found["journal"]["broken"][0]


def test_entries_that_are_older_than_they_are_kept_are_not_missed(
    small_files: Path, tmp_path: Path, cli: Cli
) -> None:
    year = 365.25
    make(small_files, tmp_path / "runs", (9 * year, 8 * year, year))
    for path in files_of(small_files)[:-3]:
        os.utime(path, (0, 0))
        files.remove_oldest(small_files, 5 * files.YEAR_S, NOW_NS / NS_PER_S)
    second = read_info(tmp_path / "runs" / NAMES[1]).metadata[INFO_RECORD]
    assert second["decisions"] not in read_log(small_files).heads
    assert len(report(cli, "--no-check")["stops"]) == 1
    assert "knows 3 of 3 files" in cli("verify", str(tmp_path / "runs")).out


def test_since_asks_the_recordings_for_their_times_and_not_the_journal_alone(
    small_files: Path, tmp_path: Path, cli: Cli
) -> None:
    make(small_files, tmp_path / "runs", (3, 2, 1))
    for path in files_of(small_files):  # as if all entries were from 1970
        path.write_bytes(re.sub(b'"time_ns":[0-9]+', b'"time_ns":1', path.read_bytes()))
    found = report(cli, "--no-check", "--since", "60h", exit_code=7)
    assert [Path(each["path"]).name for each in found["recordings"]] == list(NAMES[1:])


FIRST, SECOND = "robot_20260101_120000", "robot_20260102_120000"


@pytest.fixture
def sealed_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two sealed recordings that a journal of decisions names; `early.mcap` is an early copy
    of the first.
    """
    monkeypatch.setattr("robotctl.decisions.log.END_S", 30.0)
    monkeypatch.setattr(  # it takes seconds, and tells nothing of the seal
        "robotctl.check.run.check_recordings",
        lambda paths, on_progress: [{"verdict": "same"} for _ in paths],
    )
    folder = tmp_path / "runs"
    keys = Keyring(seal_folder("robot"), "robot")
    options = RecorderOptions(chunk_bytes=1 << 12, flush_s=0.005, sealer=keys)
    log = DecisionLog(log_folder("robot"), 0.0)
    written = drive(0.5)
    numbers = count()

    def copied() -> int:
        shutil.copy(file_of(folder), tmp_path / "early.mcap")
        with suppress(UnreadableFile):  # it is being written
            return read_info(tmp_path / "early.mcap").message_count
        return 0

    def copy_early(recorder: Recorder, _: int) -> None:
        half = len(written) // 2
        if next(numbers) == half:
            until(lambda: copied() == half)

    for name in (FIRST, SECOND):
        log.add(DecisionKind.START, by="ada", version="1", recording=str(folder / name))
        record(folder / name, written, options=options, beside=copy_early)
        log.add(DecisionKind.END)
    log.close()
    return folder


def file_of(runs: Path, name: str = FIRST) -> Path:
    return runs / name / f"{name}_0.mcap"


def early(runs: Path) -> None:
    (runs / FIRST / "metadata.yaml").unlink()
    (runs.parent / "early.mcap").replace(file_of(runs))


def another(runs: Path) -> None:
    (runs / FIRST / "metadata.yaml").unlink()
    file_of(runs, SECOND).replace(file_of(runs))
    shutil.rmtree(runs / SECOND)


def written_again(by: str | None) -> Callable[[Path], None]:
    """Return what writes the first recording again, sealed with a key of that name."""

    def write(runs: Path) -> None:
        contents = contents_of(file_of(runs))
        shutil.rmtree(runs / FIRST)
        sealer = keyring(runs.parent / "attacker", by) if by else None
        write_contents(runs / FIRST, contents, sealer)

    return write


def test_sealed_recordings_of_the_journal_exit_with_0(sealed_runs: Path, cli: Cli) -> None:
    assert cli("verify", str(sealed_runs)).exit_code == 0
    out = cli("evidence").succeeded()
    assert out.count("verify sealed, check same") == 2
    assert "this machine's list of keys knows 2 of 2 files" in out


@pytest.mark.parametrize(
    ("put", "sentence"),
    [
        (early, "this machine knows another end of it"),
        (another, f"knows {FIRST}_0.mcap with another key"),
        (written_again("robot"), f"knows {FIRST}_0.mcap with another key"),
        (written_again("nobody"), f"knows {FIRST}_0.mcap with another key"),
        (written_again(None), "knows a seal of it, which is not there"),
    ],
)
def test_what_stands_in_the_place_of_a_sealed_file_exits_with_7(
    sealed_runs: Path, cli: Cli, put: Callable[[Path], None], sentence: str
) -> None:
    put(sealed_runs)
    for command in (("verify", str(sealed_runs)), ("evidence",)):
        cli(*command).failed(7, out=sentence)
    items = cli("evidence", "--json").summary["recordings"]
    assert items[0]["verify"] == "broken"


def test_two_copies_of_a_file_break_the_chain_of_both(sealed_runs: Path, cli: Cli) -> None:
    (sealed_runs / FIRST / "metadata.yaml").unlink()
    shutil.copy(file_of(sealed_runs, SECOND), file_of(sealed_runs))
    shutil.rmtree(seal_folder("robot").parent)
    cli("verify", str(sealed_runs)).failed(7, out="have the same place in the chain")


def test_a_renamed_folder_and_a_copy_elsewhere_stay_sealed(
    sealed_runs: Path, cli: Cli, tmp_path: Path
) -> None:
    shutil.copytree(sealed_runs / FIRST, tmp_path / "copy" / "accident")
    out = cli("verify", str(tmp_path / "copy")).succeeded()
    assert "it was sealed as" not in out
    shutil.copy(file_of(sealed_runs), tmp_path / "stop.mcap")
    cli("verify", str(tmp_path / "stop.mcap")).succeeded(
        f"stop.mcap: it was sealed as {FIRST}_0.mcap: it was renamed"
    )


def test_a_repaired_copy_is_no_forgery_but_evidence_misses_its_seal(
    sealed_runs: Path, cli: Cli, tmp_path: Path
) -> None:
    recover(file_of(sealed_runs), tmp_path / "copy.mcap")
    assert cli("verify", str(tmp_path / "copy.mcap")).exit_code == 4
    (sealed_runs / FIRST / "metadata.yaml").unlink()
    (tmp_path / "copy.mcap").replace(file_of(sealed_runs))
    assert cli("verify", str(sealed_runs)).exit_code == 4
    cli("evidence").failed(6, out="this machine knows its end, which no copy proves")
