"""The chain of a journal finds an entry that was changed, however many lie before a snapshot."""

from __future__ import annotations

import pytest

from robotctl.kernel.snapshot import Proof
from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, encode
from robotctl.rerun.journal_chain import MAX_ENTRIES, JournalChain

COUNTS = (0, 1, MAX_ENTRIES - 1, MAX_ENTRIES, MAX_ENTRIES + 1, 3 * MAX_ENTRIES + 7)


def entry(seq: int, kind: EntryKind = EntryKind.EVENT) -> JournalEntry:
    return JournalEntry(seq, seq * 10, kind, "Tick", f'{{"t_ns":{seq * 10}}}')


def is_whole(
    written: list[JournalEntry], recorded: list[bytes], missing: int | None = None
) -> bool:
    """Return whether a chain finds these recorded entries whole, after a first snapshot."""
    chain, begin = JournalChain(), entry(0, EntryKind.SNAPSHOT)
    chain.add(0, encode(begin))
    assert chain.is_whole(begin, Proof(0, 0))
    crc = chained(encode(begin), 0)
    for each in written:
        crc = chained(encode(each), crc)
    for seq, serialized in enumerate(recorded, 1):
        if seq != missing:
            chain.add(seq, serialized)
    end = entry(len(recorded) + 1, EntryKind.SNAPSHOT)
    chain.add(end.seq, encode(end))
    return chain.is_whole(end, Proof(0, crc))


@pytest.mark.parametrize("count", COUNTS)
def test_the_entries_that_were_written_are_whole(count: int) -> None:
    written = [entry(seq) for seq in range(1, count + 1)]
    assert is_whole(written, [encode(each) for each in written])


@pytest.mark.parametrize("count", COUNTS[1:])
def test_padding_of_dds_changes_nothing(count: int) -> None:
    written = [entry(seq) for seq in range(1, count + 1)]
    assert is_whole(written, [encode(each) + b"\0\0" for each in written])


@pytest.mark.parametrize("count", COUNTS[1:])
@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
def test_an_entry_that_was_changed_is_found(count: int, place: float) -> None:
    written = [entry(seq) for seq in range(1, count + 1)]
    recorded = [encode(each) for each in written]
    number = round(place * (count - 1))
    recorded[number] = recorded[number].replace(b"Tick", b"Tock")
    assert not is_whole(written, recorded)


def test_after_a_gap_nothing_is_known_until_the_next_snapshot() -> None:
    written = [entry(seq) for seq in range(1, 9)]
    recorded = [encode(each) for each in written]
    assert is_whole(written[1:], recorded, missing=4)
