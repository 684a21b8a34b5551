"""A flipped bit in an event is found by its checksum, and with a repaired checksum by its effect.

With a repaired checksum only flips in digits, without any effect on a decision, are not found.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from robotctl.base.errors import UnreadableFile
from robotctl.check.compare import first_divergence
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.recording import Compression, RecorderOptions
from robotctl.recording.format.journal import JournalEntry, decode, encode
from robotctl.testing.drives import Written, drive, record
from tests.support.checked_drives import entries_of

EVERY = 23
"""Only each 23rd bit is flipped, to be quick; that reaches every position within a byte."""

EVENTS = pytest.mark.parametrize("name", ["Tick", "OdomReceived", "DriveRequested"])


@cache
def short_drive() -> list[Written]:
    return drive(0.3)


def last(written: list[Written], name: str) -> tuple[int, JournalEntry]:
    """Return the last event of that name that is followed by others, and its position."""
    return [
        (position, each)
        for position, each in enumerate(written[:-10])
        if isinstance(each, JournalEntry) and each.name == name
    ][-1]


def flipped(data: bytes) -> Iterator[bytes]:
    """Yield the bytes with one bit flipped, for many bits."""
    for bit in range(0, 8 * len(data), EVERY):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)


@EVENTS
def test_every_bit_that_flips_on_the_disk_is_found_and_its_place_is_named(
    tmp_path: Path, name: str
) -> None:
    options = RecorderOptions(compression=Compression.NONE, chunk_bytes=1 << 12)
    (file,) = record(tmp_path / "run", short_drive(), options=options).glob("*.mcap")
    whole = file.read_bytes()
    event = encode(last(short_drive(), name)[1])
    assert whole.count(event) == 1
    for changed in flipped(event):
        file.write_bytes(whole.replace(event, changed))
        report = check_recording(file)
        assert report.verdict is Verdict.INCOMPLETE
        assert any("chunk" in sentence for sentence in report.missing), report.missing


@EVENTS
def test_behind_a_repaired_checksum_only_numbers_that_change_nothing_escape(name: str) -> None:
    entries = entries_of(short_drive())
    _, event = last(short_drive(), name)
    position = entries.index(event)
    found = 0
    for changed in flipped(encode(event)):
        try:
            read = decode(changed)
            entries[position] = read
            escaped = first_divergence(entries) is None
        except UnreadableFile:
            escaped = False
        found += not escaped
        if escaped:  # or a byte between the fields, which means nothing
            assert read._replace(data="") == event._replace(data="")
            assert shape(read.data) == shape(event.data)
    assert found > 15


def shape(data: str) -> str:
    """Return the text without its digits."""
    return "".join(character for character in data if not character.isdigit())


@EVENTS
def test_a_flipped_bit_that_changes_a_decision_is_found_and_its_event_is_named(
    tmp_path: Path, name: str
) -> None:
    position, entry = last(short_drive(), name)
    digit = next(i for i, character in enumerate(entry.data) if character in "123456789")
    flipped = chr(ord(entry.data[digit]) ^ 1)
    data = entry.data[:digit] + flipped + entry.data[digit + 1 :]
    changed = [*short_drive()]
    changed[position] = entry._replace(data=data)
    report = check_recording(record(tmp_path / "run", changed))
    assert report.verdict is Verdict.DIVERGED
    assert report.divergence is not None
    assert report.divergence.event == f"{name} {data}"
