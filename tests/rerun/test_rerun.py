"""A new kernel decides on a journal again, and the first difference is found.

The entries of a journal may come in any order.
"""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.journal_steps import Gap, Step, in_sequence, steps
from robotctl.rerun.rerun import first_divergence
from robotctl.testing.drives import drive


def a_journal() -> list[JournalEntry]:
    """Return the journal of a drive up to the command of a tick."""
    written = drive(2.0, snapshots_s=(0.0, 1.0))
    journal = [each for each in written if isinstance(each, JournalEntry)]
    while journal[-1].name != "PublishTwist":
        journal.pop()
    return journal


def test_the_same_events_give_the_same_effects() -> None:
    journal = a_journal()
    assert any('"linear":0.3' in entry.data for entry in journal)
    assert first_divergence(journal) is None


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


def test_the_effects_of_the_last_event_may_be_cut_off() -> None:
    assert first_divergence(a_journal()[:-1]) is None


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


def test_a_step_before_a_gap_is_cut_and_effects_behind_it_are_passed_over() -> None:
    entries = [entry(0), entry(1, EntryKind.EFFECT), entry(4, EntryKind.EFFECT), entry(5)]
    found = list(steps(entries))
    assert [type(each) for each in found] == [Step, Gap, Step]
    first = found[0]
    assert isinstance(first, Step)
    assert first.cut
    assert [effect.seq for effect in first.effects] == [1]
