"""`robotctl gate`: every recording is judged once by each robotctl, and what is wrong is named."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path
from xml.etree import ElementTree

import pytest

from robotctl.collection import gate as gates
from robotctl.collection import judgement, judging
from robotctl.collection.gate import junit_text
from robotctl.collection.jobs import local_processes, results_of
from robotctl.collection.judgement import judge
from robotctl.collection.judging import ResultStore
from robotctl.rerun.check_report import Verdict
from robotctl.testing.drives import drive, record
from tests.support.checked_drives import judged, wrong

GOOD, WRONG = "robot_20260101_120000", "robot_20260102_120000"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("gate")
    written = drive(2.0)
    record(folder / GOOD, written)
    record(folder / WRONG, wrong(written))
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "recordings"))


def test_what_is_decided_differently_closes_the_gate_with_its_first_cause(folder: Path) -> None:
    report = judged(folder)
    assert report.counts()[Verdict.DIVERGED] == report.counts()[Verdict.SAME] == 1
    assert list(report.failures()) == [folder / WRONG]
    ((cause, paths),) = report.causes().items()
    assert cause.startswith("diverged: after Tick at entry N: ")
    assert paths == [folder / WRONG]


def test_nothing_is_judged_twice_by_the_same_software(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = judged(folder)
    monkeypatch.setattr(judging, "judge", lambda *_, **__: pytest.fail("it was judged again"))
    second = judged(folder)
    assert (first.stored, second.stored) == (0, 2)
    assert second.results == first.results


def test_other_software_or_parameters_or_bytes_are_judged_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged(folder)
    assert judged(folder, settings={"limits.linear_mps": "0.3"}).stored == 0
    (file,) = (folder / GOOD).glob("*.mcap")
    file.write_bytes(file.read_bytes() + b"\0")
    assert judged(folder).stored == 1
    for module in (gates, judgement, judging):
        monkeypatch.setattr(module, "software_hash", lambda: "another")
    assert judged(folder).stored == 0


def test_other_parameters_that_change_a_mode_close_the_gate(folder: Path) -> None:
    report = judged(folder, settings={"tracking.k_y": "7.0"})
    assert not report.results[folder / GOOD].differs
    report = judged(folder, settings={"limits.linear_mps": "0.05", "tracking.max_error_m": "0.05"})
    assert report.results[folder / GOOD].differs
    assert folder / GOOD in report.failures()


def test_the_report_for_continuous_integration_names_each_recording(folder: Path) -> None:
    report = judged(folder)
    report.lost[folder / "gone\x1b"] = "the process that judged it was killed"
    suite = ElementTree.fromstring(junit_text(report))
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "1", "1")
    cases = {each.get("name"): [child.tag for child in each] for each in suite}
    assert cases == {GOOD: [], WRONG: ["failure"], "gone\\x1b": ["error"]}


def test_a_result_is_stored_once_and_a_damaged_one_is_made_again(
    made: Path, tmp_path: Path
) -> None:
    results = ResultStore(tmp_path)
    result = judge(made / GOOD, {})
    assert results.get(result.key) is None
    assert results.put(result) == result
    (stored,) = tmp_path.iterdir()
    before = stored.stat()
    assert results.put(result) == result
    assert stored.stat() == before
    other = judge(made / WRONG, {})
    results.put(other)
    forged = (tmp_path / f"{other.key}.json").read_text()
    for damage in ("{", forged):
        stored.write_text(damage)
        assert results.get(result.key) is None
        assert results.put(result) == result
        assert results.get(result.key) == result


def die_at(path: Path) -> str:
    """Be killed: each time at `always`, the first time at `once`."""
    if path.name == "always" or (path.name == "once" and not path.exists()):
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return path.name


@pytest.mark.parametrize(("deadly", "result"), [("once", "once"), ("always", None)])
def test_a_killed_process_loses_no_other_result(
    tmp_path: Path, deadly: str, result: str | None
) -> None:
    names = ["first", deadly, "last"]
    found = list(results_of(die_at, [tmp_path / name for name in names], local_processes))
    assert sorted((path.name, said or "") for path, said in found) == sorted(
        [("first", "first"), ("last", "last"), (deadly, result or "")]
    )


def test_an_unreadable_recording_is_unknown(folder: Path) -> None:
    for file in (folder / GOOD).glob("*.mcap"):
        file.write_bytes(b"no MCAP")
    report = judged(folder)
    assert list(report.unknown()) == [folder / GOOD]
