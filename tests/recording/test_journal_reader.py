"""The journal of the recording robot is found among others, and read in the order of writing."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pytest

from robotctl.errors import UnreadableFile
from robotctl.messages.cdr import JOURNAL_ENTRY
from robotctl.recording import Recorder, RecorderOptions, Recording, Topic
from robotctl.recording.format.journal import (
    EntryKind,
    JournalEntry,
    decode,
    encode,
)
from robotctl.recording.read.journal_reader import journal_topic, read_journal
from robotctl.testing.drives import GID, START_NS, TWIST


def record(folder: Path, robot: str, topics: dict[str, Iterable[int]]) -> Path:
    """Return a recording of journals whose entries have these log times after START_NS."""
    options = RecorderOptions(chunk_bytes=1024)
    recorder = Recorder(folder, options, metadata=lambda: {"robot": robot}, on_failure=pytest.fail)
    recorder.add_topic(TWIST)
    for name, times in topics.items():
        channel = recorder.add_topic(Topic(name, JOURNAL_ENTRY))
        for seq, time_ns in enumerate(times):
            entry = encode(JournalEntry(seq, seq, EntryKind.EVENT, "Tick", name))
            recorder.write(channel, entry, START_NS + time_ns, START_NS, seq + 1, GID)
    recorder.close()
    return folder


@pytest.mark.parametrize(
    ("robot", "topics", "found"),
    [
        ("robot", ["/robotctl/journal"], "/robotctl/journal"),
        ("r2", ["/robotctl/journal", "/r2/robotctl/journal"], "/r2/robotctl/journal"),
        ("robot", ["/robotctl/journal", "/r2/robotctl/journal"], "/robotctl/journal"),
        ("robot", ["/renamed"], "/renamed"),
        ("robot", ["/a", "/b"], None),
        ("robot", [], None),
    ],
)
def test_the_journal_is_that_of_the_robot_that_recorded(
    tmp_path: Path, robot: str, topics: list[str], found: str | None
) -> None:
    folder = record(tmp_path / "run", robot, {name: [1] for name in topics})
    with Recording(folder) as recording:
        assert journal_topic(recording.info()) == found
        if found:
            assert {each.entry.data for each in read_journal(recording, pytest.fail)} == {found}
        else:
            with pytest.raises(UnreadableFile, match="holds no journal"):
                next(read_journal(recording, pytest.fail))


def test_entries_come_as_they_were_written_though_the_clock_was_set_back(tmp_path: Path) -> None:
    times = [*range(5000, 5400), *range(100, 500), *range(5100, 5200)]
    with Recording(record(tmp_path / "run", "robot", {"/robotctl/journal": times})) as recording:
        read = list(read_journal(recording, pytest.fail))
    assert [each.entry.seq for each in read] == list(range(900))
    assert [each.log_ns - START_NS for each in read] == times


def test_a_damaged_chunk_is_told_and_the_rest_is_read(tmp_path: Path) -> None:
    folder = record(tmp_path / "run", "robot", {"/robotctl/journal": range(500)})
    (file,) = folder.glob("*.mcap")
    with Recording(folder) as recording:
        place = recording._files[0].index.places[3]
    data = bytearray(file.read_bytes())
    data[place.offset + place.length - 5] ^= 0xFF
    file.write_bytes(data)
    missing: list[str] = []
    with Recording(folder) as recording:
        read = list(read_journal(recording, missing.append))
    assert len(missing) == 1
    assert 0 < len(read) < 500


@pytest.mark.parametrize(
    ("at", "byte", "says"),
    [
        (24, 0, "it has no name or kind"),
        (25, 1, "its name has 261 bytes, more than 255"),
        (20, 3, "it has no name or kind"),
        (1, 7, "not little-endian CDR"),
    ],
)
def test_an_entry_with_a_damaged_head_is_told(at: int, byte: int, says: str) -> None:
    damaged = bytearray(encode(JournalEntry(1, 2, EntryKind.EVENT, "Tick", "{}")))
    damaged[at] = byte
    with pytest.raises(UnreadableFile, match=says):
        decode(bytes(damaged))


def test_a_name_that_no_entry_can_hold_is_refused() -> None:
    with pytest.raises(KeyError):
        encode(JournalEntry(1, 2, EntryKind.EVENT, "x" * 255, "{}"))
