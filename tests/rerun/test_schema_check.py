"""A check compares what the file tells of a topic with the type that it names."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from robotctl.recording.format.metadata_names import LEDGER_RECORD
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Report, Verdict
from robotctl.testing.drives import Written, installed_topic
from tests.support.edited_recordings import Contents, recorded, write_contents

MARKS = "/robotctl/marks"


def with_marks(contents: Contents, type_name: str, text: str, type_hash: str) -> Contents:
    """Return the contents with a topic that no decision is made on, without messages."""
    channel, schema = contents.types[0]
    values = {**channel.metadata, "topic_type_hash": type_hash}
    marks = (
        replace(channel, topic=MARKS, metadata=values),
        replace(schema, name=type_name, data=text.encode()),
    )
    again = contents.copy()
    again.types = [*contents.types, marks]
    ledger = dict(again.metadata)[LEDGER_RECORD]
    ledger[MARKS] = json.dumps(dict.fromkeys(json.loads(ledger[channel.topic]), 0))
    return again


@pytest.fixture
def honest(tmp_path: Path, drive_of_3_s: list[Written]) -> Contents:
    return recorded(tmp_path / "honest", drive_of_3_s)


def checked(folder: Path, contents: Contents) -> Report:
    return check_recording(write_contents(folder / "run", contents))


STRING = installed_topic(MARKS, "std_msgs/msg/String")


def test_what_is_installed_of_another_type_is_compared(tmp_path: Path, honest: Contents) -> None:
    text = STRING.definition.replace("data", "other")
    report = checked(tmp_path, with_marks(honest, STRING.type_name, text, STRING.type_hash))
    (violation,) = report.violations
    assert (report.verdict, MARKS in violation.text) == (Verdict.BROKEN, True)


def test_the_installed_definition_of_another_type_is_in_order(
    tmp_path: Path, honest: Contents
) -> None:
    described = STRING.type_name, STRING.definition, STRING.type_hash
    report = checked(tmp_path, with_marks(honest, *described))
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])


@pytest.mark.parametrize("text", ["string data\n", "no field", "no_msgs/Unknown data\n"])
def test_a_type_that_is_not_installed_and_contradicts_its_hash_is_a_note(
    tmp_path: Path, honest: Contents, text: str
) -> None:
    report = checked(tmp_path, with_marks(honest, "no_msgs/msg/T", text, "RIHS01_ab"))
    (note,) = report.notes
    assert (report.verdict, MARKS in note) == (Verdict.SAME, True)


def test_a_type_without_a_hash_is_not_compared(tmp_path: Path, honest: Contents) -> None:
    report = checked(tmp_path, with_marks(honest, "no_msgs/msg/T", "string data\n", ""))
    assert (report.verdict, report.missing, report.notes) == (Verdict.SAME, [], [])


def test_only_what_one_file_tells_is_compared_as_well(tmp_path: Path, honest: Contents) -> None:
    """A forger may describe a topic twice, once as it is."""
    channel, schema = next(each for each in honest.types if each[0].topic == "/odom")
    text = schema.data.replace(b"float64 x\n", b"float64 other\n")
    twice = honest.copy()
    twice.types = [(channel, replace(schema, data=text)), *honest.types]
    report = checked(tmp_path, twice)
    assert report.verdict is Verdict.BROKEN
