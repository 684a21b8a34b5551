"""A check decides across changes of parameters; no snapshot changes one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl import __version__
from robotctl.kernel.modes import Mode
from robotctl.kernel.parameter_change import ParameterRequested
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.types import DriveRequested, Event, ModeRequested
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.journal import JournalEntry
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.resim import resimulate
from robotctl.rerun.sentences import sentence_of
from robotctl.rerun.whatif import what_if
from robotctl.testing.drives import BEGIN_NS, Written, drive, record

KEY = "limits.linear_mps"


def requests() -> list[Event]:
    """A drive, a stop, two changes of a limit, the second while MOVING, and another drive."""

    def at(after_s: float) -> int:
        return BEGIN_NS + round(after_s * NS_PER_S)

    return [
        DriveRequested(at(0.1), 1, Pattern(), 0, False, "operator"),
        ModeRequested(at(1.0), 2, Mode.IDLE, "operator"),
        ParameterRequested(at(2.0), 3, KEY, "0.6", "0.3", "operator"),
        DriveRequested(at(2.1), 4, Pattern(), 0, False, "operator"),
        ParameterRequested(at(2.5), 5, KEY, "0.3", "0.5", "operator"),
    ]


@pytest.fixture(scope="module")
def written() -> list[Written]:
    return drive(3.5, requests=requests(), snapshots_s=(0.0, 1.5, 3.0))


def edited(written: list[Written], edit: Callable[[JournalEntry], JournalEntry]) -> list[Written]:
    return [edit(each) if isinstance(each, JournalEntry) else each for each in written]


def test_a_drive_with_a_change_is_the_same(tmp_path: Path, written: list[Written]) -> None:
    report = check_recording(record(tmp_path / "r", written))
    assert (report.verdict, report.missing, report.violations) == (Verdict.SAME, [], [])
    changes = [e for e in written if isinstance(e, JournalEntry) and e.name == "ParameterChanged"]
    assert [json.loads(e.data) for e in changes] == [
        {"key": KEY, "old": "0.6", "new": "0.3", "source": "operator"}
    ]


@pytest.mark.parametrize("name", ["ParameterRequested", "ParameterChanged"])
def test_another_new_value_is_found(tmp_path: Path, written: list[Written], name: str) -> None:
    def edit(entry: JournalEntry) -> JournalEntry:
        data = entry.data.replace('"new":"0.3"', '"new":"0.35"')
        return entry._replace(data=data) if entry.name == name else entry

    report = check_recording(record(tmp_path / "r", edited(written, edit)))
    assert report.verdict in (Verdict.DIVERGED, Verdict.BROKEN)


@pytest.mark.parametrize("version", ["0.1.0", __version__])
def test_a_snapshot_with_another_parameter_is_found_in_every_version(
    tmp_path: Path, written: list[Written], version: str
) -> None:
    snapshots = [e for e in written if isinstance(e, JournalEntry) and e.name == "Snapshot"]

    def edit(entry: JournalEntry) -> JournalEntry:
        if entry is not snapshots[1]:
            return entry
        return entry._replace(data=entry.data.replace('"linear_mps":0.6', '"linear_mps":0.9'))

    report = check_recording(record(tmp_path / "r", edited(written, edit), version=version))
    assert report.divergence is not None
    assert report.verdict is not Verdict.SAME


def test_a_change_while_moving_breaks_a_promise(tmp_path: Path, written: list[Written]) -> None:
    """As a kernel would record it that forgot the rule: the invariants are independent of it."""
    text = '{"key":"limits.linear_mps","old":"0.3","new":"0.5","source":"operator"}'

    def edit(entry: JournalEntry) -> JournalEntry:
        if entry.name == "Reply" and '"request_id":5' in entry.data:
            return entry._replace(name="ParameterChanged", data=text)
        return entry

    report = check_recording(record(tmp_path / "r", edited(written, edit)))
    assert report.verdict in (Verdict.DIVERGED, Verdict.BROKEN)


def test_a_what_if_keeps_its_own_value_over_a_change(
    tmp_path: Path, written: list[Written]
) -> None:
    found = what_if(record(tmp_path / "r", written), {KEY: "0.2"})
    assert found["linear_mps"]["max"] > 0.05
    assert [each["request_id"] for each in found["answers"]][:1] == [3]


def test_a_simulation_repeats_the_change(tmp_path: Path, written: list[Written]) -> None:
    found = resimulate(record(tmp_path / "r", written), {})
    second = found["drives"][1]
    assert second["simulated"]["distance_m"] == pytest.approx(
        second["recorded"]["distance_m"] if second["recorded"] else 0.0, abs=0.5
    )


def test_a_change_is_told_as_a_sentence() -> None:
    (request,) = (each for each in requests() if sentence_of(each).endswith("0.3 by operator"))
    assert sentence_of(request) == f"a request to change {KEY} from 0.6 to 0.3 by operator"
