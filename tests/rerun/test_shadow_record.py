"""The record of a shadow in a recording is found, told, and never in the way of the decisions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.cdr.known_types import JOURNAL_ENTRY
from robotctl.kernel.types import ModeRequested
from robotctl.recording import Recorder, RecorderOptions, read_info
from robotctl.recording.format.journal import EntryKind, JournalEntry, encode
from robotctl.recording.format.metadata_names import SHADOW_RECORD
from robotctl.recording.read.journal_reader import journal_topics
from robotctl.recording.read.shadow_record import MAX_CHARACTERS, shadow_sentence
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.rerun.incident import find_incident
from robotctl.testing.drives import BEGIN_NS, drive, drive_requested, installed_topic, record

SHADOW = installed_topic("/robotctl/shadow", JOURNAL_ENTRY)
ESTOP = ModeRequested(BEGIN_NS + 1_000_000_000, 2, 3, "operator")
OWN = {"file": "next.yaml", "digest": "01", "parameter.tracking.k_y": "8.0"}


def recorded(
    folder: Path, data_of: Callable[[int], bytes], metadata: dict[str, str] | None = None
) -> Path:
    """A drive that is stopped, with the data of a shadow beside each of its messages, by number."""
    channel: int | None = None
    number = 0

    def beside(recorder: Recorder, time_ns: int) -> None:
        nonlocal channel, number
        channel = recorder.add_topic(SHADOW) if channel is None else channel
        recorder.write(channel, data_of(number), time_ns, time_ns, 0, bytes(16))
        number += 1

    options = RecorderOptions(records={} if metadata is None else {SHADOW_RECORD: metadata})
    written = drive(1.2, requests=[drive_requested(), ESTOP])
    return record(folder, written, beside=beside, options=options)


def entry(seq: int) -> bytes:
    return encode(JournalEntry(seq, 0, EntryKind.EFFECT, "PublishTwist", f'{{"n":{seq}}}'))


def test_the_decisions_are_checked_and_those_of_the_shadow_are_not(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "run", entry, OWN)
    report = check_recording(folder)
    assert report.verdict is Verdict.SAME
    sentence = "a shadow decided with tracking.k_y 8.0; where it differs is in /robotctl/shadow"
    assert report.notes == [f"{sentence}: not checked"]
    assert journal_topics(read_info(folder)) == {"/robotctl/journal"}


def test_an_incident_has_what_the_shadow_decided_on_its_event_alone(tmp_path: Path) -> None:
    found = find_incident(recorded(tmp_path / "run", entry, OWN)).incident
    assert found is not None
    assert found.shadow is not None
    assert [each.seq for each in found.shadow] == [found.seq]


@pytest.mark.parametrize("data", [b"", b"x" * 100, entry(1)[:-9]], ids=["none", "noise", "cut"])
def test_a_damaged_record_hides_no_incident(tmp_path: Path, data: bytes) -> None:
    folder = recorded(tmp_path / "run", lambda number: data)
    searched = find_incident(folder)
    assert searched.incident is not None
    assert searched.incident.shadow is None
    (missing,) = searched.missing
    assert missing.startswith("what the shadow decided: a journal entry is damaged")
    assert check_recording(folder).verdict is Verdict.SAME


def test_hostile_metadata_makes_no_long_sentence(tmp_path: Path) -> None:
    many = {f"parameter.{number}": "x" * 50 for number in range(1000)}
    sentence = shadow_sentence(read_info(recorded(tmp_path / "run", entry, many)))
    assert len(sentence) < MAX_CHARACTERS + 100
    without = shadow_sentence(read_info(recorded(tmp_path / "without", entry)))
    assert without.startswith("a shadow decided with other parameters; ")
