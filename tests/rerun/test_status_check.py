"""What is held against a robot status."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.format.metadata_names import INFO_RECORD, LEDGER_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from tests.support.edited_recordings import Contents, Stored, edit, write_contents
from tests.support.heard_drives import STATUS, heard_drive


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    return heard_drive(tmp_path_factory.mktemp("heard") / "run", 3.0)


def test_the_status_of_before_the_journal_may_show_another_mode(
    tmp_path: Path, heard: Contents
) -> None:
    """A clip and a split begin with the last status, which may be of long before."""

    def another(number: int, message: Stored) -> Stored:
        publish_ns = message.publish_ns - 10 * NS_PER_S
        other = replace(message, data=with_mode(message, 3), publish_ns=publish_ns)
        return message if number else other

    report = check_recording(write_contents(tmp_path / "run", edit(heard, STATUS, another)))
    assert report.verdict is Verdict.SAME, report


@pytest.mark.parametrize("set_s", [-3600, -1, 1, 3600])
def test_a_wall_clock_that_is_set_is_held_against_no_status(
    tmp_path: Path, heard: Contents, set_s: int
) -> None:
    middle_ns = heard.messages[len(heard.messages) // 2].log_ns
    edited = heard.copy()
    edited.messages = [
        replace(
            each,
            log_ns=each.log_ns + set_s * 10**9 * (each.log_ns >= middle_ns),
            publish_ns=each.publish_ns + set_s * 10**9 * (each.log_ns >= middle_ns),
        )
        for each in heard.messages
    ]
    report = check_recording(write_contents(tmp_path / "run", edited))
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


def test_a_status_that_a_file_repeats_before_it_was_sent_is_no_difference(
    tmp_path: Path, heard: Contents
) -> None:
    edited = heard.copy()
    first = next(each for each in heard.messages if each.topic == STATUS)
    edited.messages.insert(0, replace(first, log_ns=first.log_ns - 1))
    report = check_recording(write_contents(tmp_path / "run", edited))
    assert (report.verdict, report.missing) == (Verdict.SAME, [])


def renamed(contents: Contents, topic: str) -> Contents:
    """Return the recording with statuses on another topic, as its metadata says."""
    edited = edit(contents, STATUS, lambda at, each: replace(each, topic=topic))
    edited.types = [
        (replace(each, topic=topic) if each.topic == STATUS else each, schema)
        for each, schema in contents.types
    ]
    edited.counts[topic] = edited.counts[STATUS]
    for name, values in edited.metadata:
        if name == INFO_RECORD:
            values["topic.robot_status"] = topic
        elif name == LEDGER_RECORD:
            values[topic] = values.pop(STATUS)
    return edited


@pytest.mark.parametrize(("mode", "verdict"), [(1, Verdict.SAME), (2, Verdict.BROKEN)])
def test_a_status_topic_with_another_name_is_compared(
    tmp_path: Path, heard: Contents, mode: int, verdict: Verdict
) -> None:
    """The third status shows that the robot is MOVING."""
    edited = edit(
        renamed(heard, "/shown"),
        "/shown",
        lambda at, each: replace(each, data=with_mode(each, mode)) if at == 2 else each,
    )
    report = check_recording(write_contents(tmp_path / "run", edited))
    assert (report.verdict, report.missing) == (verdict, [])


def with_mode(message: Stored, mode: int) -> bytes:
    """Return the data of a status with another mode."""
    return message.data[:14] + bytes((mode,)) + message.data[15:]


def test_a_status_topic_that_is_told_and_not_recorded_is_missed(
    tmp_path: Path, heard: Contents
) -> None:
    edited = edit(heard, STATUS, lambda at, each: None)
    edited.types = [each for each in heard.types if each[0].topic != STATUS]
    report = check_recording(write_contents(tmp_path / "run", edited))
    assert report.verdict is Verdict.INCOMPLETE
    assert "its topic of robot statuses, /robot_status, is not recorded" in report.missing
