"""A new kernel decides on a journal again, and the first difference is found.

The entries of a journal are grouped into steps, in any order. Its chain finds an entry that was
changed, however many lie before a snapshot.
"""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.base.errors import UnreadableFile
from robotctl.kernel.codec import Proof, Snapshot, to_json
from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import (
    BatteryReceived,
    Event,
    ModeRequested,
    Odometry,
    OdomReceived,
    Tick,
    Twist,
)
from robotctl.recording.format.journal import EntryKind, JournalEntry, chained, encode
from robotctl.rerun import journal_steps as module
from robotctl.rerun.journal_steps import Gap, Step, in_sequence, steps
from robotctl.rerun.rerun import first_divergence
from robotctl.rerun.snapshot_proofs import MAX_ENTRIES, JournalChain

TICK_NS = 20_000_000


def a_journal() -> list[JournalEntry]:
    """Return the journal of a 2 s drive, with a snapshot at its begin and in its middle."""
    kernel = Kernel(KernelParams())
    entries: list[JournalEntry] = []

    def note(t_ns: int, kind: EntryKind, value: object) -> None:
        name = type(value).__name__
        entries.append(JournalEntry(len(entries), t_ns, kind, name, to_json(value)))

    def step(event: Event) -> None:
        note(event.t_ns, EntryKind.EVENT, event)
        for effect in kernel.step(event):
            note(event.t_ns, EntryKind.EFFECT, effect)

    note(0, EntryKind.SNAPSHOT, Snapshot("test", kernel.params, kernel.state))
    step(BatteryReceived(1, 0.9))
    for tick in range(1, 101):
        t_ns = tick * TICK_NS
        step(OdomReceived(t_ns, Odometry(Pose(0.001 * tick, 0.0, 0.0), Twist(), t_ns)))
        if tick == 2:
            step(ModeRequested(t_ns, 1, 1, "test"))
        if tick == 50:
            note(t_ns, EntryKind.SNAPSHOT, Snapshot("test", kernel.params, kernel.state))
        step(Tick(t_ns))
    return entries


def test_the_same_events_give_the_same_effects() -> None:
    journal = a_journal()
    assert any('"linear":0.3' in entry.data for entry in journal)
    assert first_divergence(journal) is None


def test_it_can_begin_in_the_middle() -> None:
    journal = a_journal()
    middle = [entry.kind for entry in journal].index(EntryKind.SNAPSHOT, 1)
    assert first_divergence(journal[middle:]) is None
    assert first_divergence(journal[middle - 10 :]) is None


def test_a_last_bit_that_differs_is_found() -> None:
    journal = a_journal()
    at = next(i for i, entry in enumerate(journal) if '"linear":0.3' in entry.data)
    last_digit = journal[at].data.replace('"linear":0.3', '"linear":0.30000000000000004')
    journal[at] = journal[at]._replace(data=last_digit)
    found = first_divergence(journal)
    assert found is not None
    assert found.seq == at
    assert found.event.startswith("Tick ")
    assert "0.30000000000000004" in found.recorded
    assert "0.30000000000000004" not in found.decided


@pytest.mark.parametrize("change", ["missing", "added"])
def test_an_effect_too_few_or_too_many_is_found(change: str) -> None:
    journal = a_journal()
    at = next(i for i, entry in enumerate(journal) if entry.name == "PublishTwist")
    if change == "missing":
        del journal[at]
    else:
        journal.insert(at, journal[at])
    journal = [entry._replace(seq=seq) for seq, entry in enumerate(journal)]
    found = first_divergence(journal)
    assert found is not None
    assert (found.recorded == "", found.decided == "") == (change == "missing", change == "added")


def test_a_snapshot_that_differs_is_found() -> None:
    journal = a_journal()
    at = [entry.kind for entry in journal].index(EntryKind.SNAPSHOT, 1)
    journal[at] = journal[at]._replace(data=journal[at].data.replace('"speed":', '"speed":1', 1))
    found = first_divergence(journal)
    assert found is not None
    assert found.seq == at


def test_the_effects_of_the_last_event_may_be_cut_off() -> None:
    journal = a_journal()
    assert journal[-1].name == "PublishTwist"
    assert first_divergence(journal[:-1]) is None


def test_a_gap_is_no_divergence_but_named() -> None:
    journal = a_journal()
    del journal[20:23]
    with pytest.raises(UnreadableFile, match="lacks the entries 20 to 22"):
        first_divergence(journal)


def test_an_event_of_another_version_is_named() -> None:
    journal = a_journal()
    at = next(i for i, entry in enumerate(journal) if entry.name == "Tick")
    journal[at] = journal[at]._replace(name="Tock")
    with pytest.raises(
        UnreadableFile, match=f"journal entry {at} cannot be read: no event is called"
    ):
        first_divergence(journal)


def test_nothing_recorded_is_no_divergence() -> None:
    assert first_divergence([]) is None


def entry(seq: int, kind: EntryKind = EntryKind.EVENT) -> JournalEntry:
    return JournalEntry(seq, seq, kind, "Tick", "{}")


def sequence_of(numbers: list[int]) -> list[int | str]:
    return [
        each.text if isinstance(each, Gap) else each.seq
        for each in in_sequence(entry(number) for number in numbers)
    ]


@given(st.permutations(range(1, 40)))
def test_entries_after_the_first_may_come_in_any_order(numbers: list[int]) -> None:
    assert sequence_of([0, *numbers]) == list(range(40))


@given(st.lists(st.integers(1, 30), max_size=60))
def test_every_entry_comes_once_and_every_hole_is_told(numbers: list[int]) -> None:
    expected: list[int | str] = [0]
    for before, number in pairwise(sorted({0, *numbers})):
        if number - before == 2:
            expected.append(f"the journal lacks entry {before + 1}")
        elif number - before > 2:
            expected.append(f"the journal lacks the entries {before + 1} to {number - 1}")
        expected.append(number)
    found = sequence_of([0, *numbers])
    repeats = [each for each in found if str(each).startswith("the journal repeats")]
    assert [each for each in found if each not in repeats] == expected
    assert len(repeats) == len(numbers) - len(set(numbers))


def test_a_hole_is_named_with_its_ends() -> None:
    assert sequence_of([3, 4, 6, 9]) == [
        *(3, 4),
        "the journal lacks entry 5",
        6,
        "the journal lacks the entries 7 to 8",
        9,
    ]


def test_what_stands_behind_its_successors_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert sequence_of([5, 6, 2, 7]) == [
        *(5, 6),
        "the journal is not in order: entry 2 follows 5",
        7,
    ]
    monkeypatch.setattr(module, "MAX_DISORDER", 2)
    found = sequence_of([0, 5, 6, 7, 1])
    assert found == [
        *(0, "the journal lacks the entries 1 to 4", 5, 6, 7),
        "the journal repeats entry 1",
    ]


def test_effects_belong_to_the_event_before_them() -> None:
    event, effect, snapshot = EntryKind.EVENT, EntryKind.EFFECT, EntryKind.SNAPSHOT
    kinds = [effect, snapshot, event, effect, effect, event, snapshot, event, effect]
    found = list(steps(entry(seq, kind) for seq, kind in enumerate(kinds)))
    shapes = [
        (each.event.seq, [effect.seq for effect in each.effects], each.cut)
        if isinstance(each, Step)
        else each
        for each in found
    ]
    assert shapes == [
        entry(1, snapshot),
        (2, [3, 4], False),
        (5, [], False),
        entry(6, snapshot),
        (7, [8], True),
    ]


def test_a_step_before_a_gap_is_cut_and_effects_behind_it_are_passed_over() -> None:
    entries = [entry(0), entry(1, EntryKind.EFFECT), entry(4, EntryKind.EFFECT), entry(5)]
    found = list(steps(entries))
    assert [type(each) for each in found] == [Step, Gap, Step]
    first = found[0]
    assert isinstance(first, Step)
    assert first.cut
    assert [effect.seq for effect in first.effects] == [1]


COUNTS = (0, 1, MAX_ENTRIES - 1, MAX_ENTRIES, MAX_ENTRIES + 1, 3 * MAX_ENTRIES + 7)


def chain_entry(seq: int, kind: EntryKind = EntryKind.EVENT) -> JournalEntry:
    return JournalEntry(seq, seq * 10, kind, "Tick", f'{{"t_ns":{seq * 10}}}')


def is_whole(
    written: list[JournalEntry], recorded: list[bytes], missing: int | None = None
) -> bool:
    """Return whether a chain finds these recorded entries whole, after a first snapshot."""
    chain, begin = JournalChain(), chain_entry(0, EntryKind.SNAPSHOT)
    chain.add(0, encode(begin))
    assert chain.is_whole(begin, Proof(0, 0))
    crc = chained(encode(begin), 0)
    for each in written:
        crc = chained(encode(each), crc)
    for seq, serialized in enumerate(recorded, 1):
        if seq != missing:
            chain.add(seq, serialized)
    end = chain_entry(len(recorded) + 1, EntryKind.SNAPSHOT)
    chain.add(end.seq, encode(end))
    return chain.is_whole(end, Proof(0, crc))


@pytest.mark.parametrize("count", COUNTS)
def test_the_entries_that_were_written_are_whole(count: int) -> None:
    written = [chain_entry(seq) for seq in range(1, count + 1)]
    assert is_whole(written, [encode(each) for each in written])


@pytest.mark.parametrize("count", COUNTS[1:])
def test_padding_of_dds_changes_nothing(count: int) -> None:
    written = [chain_entry(seq) for seq in range(1, count + 1)]
    assert is_whole(written, [encode(each) + b"\0\0" for each in written])


@pytest.mark.parametrize("count", COUNTS[1:])
@pytest.mark.parametrize("place", [0.0, 0.5, 1.0])
def test_an_entry_that_was_changed_is_found(count: int, place: float) -> None:
    written = [chain_entry(seq) for seq in range(1, count + 1)]
    recorded = [encode(each) for each in written]
    number = round(place * (count - 1))
    recorded[number] = recorded[number].replace(b"Tick", b"Tock")
    assert not is_whole(written, recorded)


def test_after_a_gap_nothing_is_known_until_the_next_snapshot() -> None:
    written = [chain_entry(seq) for seq in range(1, 9)]
    recorded = [encode(each) for each in written]
    assert is_whole(written[1:], recorded, missing=4)
