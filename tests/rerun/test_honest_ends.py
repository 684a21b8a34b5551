"""What an honest recording may hold after the last entry of its journal, and what not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from robotctl.recording.format.metadata_names import LEDGER_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.rerun.journal_origin import NOT_COMPARED
from robotctl.testing.hearing import BATTERY, ODOMETRY
from tests.support.edited_recordings import Contents, write_contents
from tests.support.heard_drives import COMMANDS, STATUS, heard_drive
from tests.tampering.edits import MOTION, Kind, still
from tests.tampering.end_kinds import appended, repeated_at_the_end
from tests.tampering.pretended_kinds import OBSERVED, UNNAMED


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    return heard_drive(tmp_path_factory.mktemp("heard") / "run", 3.0)


@pytest.fixture(scope="module")
def killed(closed: Contents) -> Contents:
    contents = closed.copy()
    contents.metadata = [each for each in closed.metadata if each[0] != LEDGER_RECORD]
    contents.messages = closed.messages[:-20]
    return contents


def checked(tmp_path: Path, contents: Contents, *kinds: Kind) -> Report:
    for kind in kinds:
        contents = kind(contents, Random(1))
    return check_recording(write_contents(tmp_path / "run", contents))


STALL = appended(COMMANDS, (8, 8), still, every_s=0.05, after_s=0.12)
"""The zeros of a stall."""


def test_a_kill_right_after_a_stall_leaves_zeros_that_a_note_explains(
    tmp_path: Path, killed: Contents
) -> None:
    report = checked(tmp_path, killed, STALL)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert any("the last 8 zeros have no decision" in note for note in report.notes)


def test_the_last_zeros_of_a_daemon_that_fails_are_no_more_than_two(
    tmp_path: Path, killed: Contents
) -> None:
    two, three = (appended(COMMANDS, (count, count), still) for count in (2, 3))
    assert checked(tmp_path / "two", killed, two).verdict is Verdict.SAME
    assert checked(tmp_path / "three", killed, three).verdict is Verdict.BROKEN


def test_a_closed_recording_tells_the_number_of_all_commands(
    tmp_path: Path, closed: Contents
) -> None:
    at_once = appended(COMMANDS, (5, 5), still)
    assert checked(tmp_path, closed, at_once).verdict is Verdict.BROKEN


@pytest.mark.parametrize(("count", "verdict"), [(2, Verdict.SAME), (30, Verdict.INCOMPLETE)])
def test_messages_that_were_lost_before_the_end_are_few(
    tmp_path: Path, closed: Contents, count: int, verdict: Verdict
) -> None:
    """The recorder has them all; the control loop lost the last ones before the last second."""
    end_ns = max(each.log_ns for each in closed.messages)

    def early(contents: Contents, random: Random) -> Contents:
        edited = contents.copy()
        last = next(each for each in reversed(contents.messages) if each.topic == BATTERY)
        edited.messages += [
            replace(last, sequence=last.sequence + 1 + number, log_ns=end_ns - 10**9 + number)
            for number in range(count)
        ]
        return edited

    report = checked(tmp_path, closed, early)
    assert report.verdict is verdict
    lost = any(f"{count} messages of the battery did not reach" in note for note in report.notes)
    assert lost is (verdict is Verdict.SAME)


def test_what_others_send_after_the_observed_daemon_died_is_held_against_nobody(
    tmp_path: Path, closed: Contents
) -> None:
    """An observer receives the journal, and outlives it."""
    observed = UNNAMED(OBSERVED(closed, Random(1)), Random(1))
    observed.metadata = [each for each in observed.metadata if each[0] != LEDGER_RECORD]
    later = [
        appended(topic, (100, 100), first=10, every_s=0.1, after_s=1.0)
        for topic in (ODOMETRY, BATTERY)
    ]
    teleop = appended(
        COMMANDS, (100, 100), lambda each: replace(each, data=MOTION), first=-40, after_s=9.0
    )
    report = checked(tmp_path / "observed", observed, *later, teleop)
    assert (report.verdict, report.missing) == (Verdict.SAME, []), report
    assert any("100 commands are later than the journal" in note for note in report.notes)
    assert NOT_COMPARED in report.notes
    assert checked(tmp_path / "own", closed, *later, teleop).verdict is Verdict.BROKEN


def test_files_that_were_put_together_repeat_the_last_status(
    tmp_path: Path, closed: Contents
) -> None:
    """Two snapshots: the second file began with the last status of the first."""
    again = repeated_at_the_end(STATUS, (1, 1), lambda each: each)
    assert checked(tmp_path / "once", closed, again).verdict is Verdict.SAME
    often = checked(tmp_path / "often", closed, again, again, again)
    assert often.missing == ["1 robot statuses are repeated where no file begins"]
