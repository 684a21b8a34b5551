"""A new kernel decides on a journal again, and the first difference is found."""

from __future__ import annotations

import pytest

from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.types import (
    BatteryReceived,
    Event,
    ModeRequested,
    Odometry,
    OdomReceived,
    Tick,
    Twist,
)
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.rerun.rerun import first_divergence

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
