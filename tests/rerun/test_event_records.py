"""The events in the metadata are those of the journal, but for the end of a killed recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.kernel.types import ModeRequested
from robotctl.recording.format.metadata_names import EVENT_RECORD, LEDGER_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.testing.drives import BEGIN_NS, Written, drive, drive_requested
from tests.support.edited_recordings import Contents, recorded, write_contents


@pytest.fixture(scope="module")
def stopped() -> list[Written]:
    stop = ModeRequested(BEGIN_NS + 4_500_000_000, 2, 3, "robotctl estop")
    return drive(5.0, requests=[drive_requested(), stop])


@pytest.fixture
def killed(tmp_path: Path, stopped: list[Written]) -> Contents:
    """Return a recording that was not closed, 0.5 s after an emergency stop."""
    contents = recorded(tmp_path / "honest", stopped[:-1])
    contents.metadata = [each for each in contents.metadata if each[0] != LEDGER_RECORD]
    return contents


def checked(folder: Path, contents: Contents, is_kept: Callable[[dict[str, str]], bool]) -> Report:
    """Check a recording with only those events that are kept."""
    edited = contents.copy()
    edited.metadata = [
        (name, values)
        for name, values in contents.metadata
        if name != EVENT_RECORD or is_kept(values)
    ]
    return check_recording(write_contents(folder / "run", edited))


def test_an_event_may_lack_at_the_end_of_a_recording_that_was_killed(
    tmp_path: Path, killed: Contents
) -> None:
    report = checked(tmp_path, killed, lambda values: False)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


def test_one_may_stand_in_the_metadata_before_its_entry_is_recorded(
    tmp_path: Path, killed: Contents
) -> None:
    ended = next(i for i, each in enumerate(killed.messages) if b"DriveEnded" in each.data[:60])
    del killed.messages[ended:]
    report = checked(tmp_path, killed, lambda values: True)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


def test_none_may_lack_in_a_recording_that_was_closed(
    tmp_path: Path, stopped: list[Written]
) -> None:
    contents = recorded(tmp_path / "honest", stopped)
    honest = checked(tmp_path / "all", contents, lambda values: True)
    assert honest.verdict is Verdict.SAME
    report = checked(tmp_path / "less", contents, lambda values: values["kind"] != "estop")
    (violation,) = report.violations
    assert "in the journal estop" in violation.text
