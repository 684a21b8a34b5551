"""The entries of a journal are grouped into steps, in any order."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun import entry_order as module
from robotctl.rerun.entry_order import Gap, in_sequence
from robotctl.rerun.journal_steps import Step, steps


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
