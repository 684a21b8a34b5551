"""A new kernel decides on a journal again; each broken invariant is found."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import inf, nan

from hypothesis import given
from hypothesis import strategies as st

from robotctl.check.compare import first_divergence
from robotctl.check.invariants import MAX_VIOLATIONS, Invariants, unbalanced
from robotctl.check.journal import Gap, Step, in_sequence, steps
from robotctl.kernel.codec import Snapshot
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    BatteryReceived,
    Effect,
    Event,
    LatchEmergencyStop,
    ModeChanged,
    ModeRequested,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    ResetRequested,
    Tick,
    Twist,
)
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.testing.drives import drive
from tests.support.cases import for_each
from tests.support.checked_drives import entries_of


def a_journal() -> list[JournalEntry]:
    """Return the journal of a drive up to the command of a tick."""
    journal = entries_of(drive(2.0, snapshots_s=(0.0, 1.0)))
    while journal[-1].name != "PublishTwist":
        journal.pop()
    return journal


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


MOVING, IDLE, STOP = Mode.MOVING, Mode.IDLE, Mode.EMERGENCY_STOP
TICK_NS = 20_000_000


def broken(mode: Mode, steps: Sequence[tuple[Event, Sequence[Effect]]]) -> list[str]:
    """Return the violations of these steps of a kernel in `mode`."""
    found = Invariants()
    found.snapshot(Snapshot("test", KernelParams(), State(mode=mode, tick_t_ns=0)))
    for seq, (event, effects) in enumerate(steps):
        found.step(seq, event, tuple(effects))
    found.end(())
    assert found.count == len(found.violations)
    return [violation.text for violation in found.violations]


def tick(number: int, *effects: Effect) -> tuple[Event, Sequence[Effect]]:
    return Tick(number * TICK_NS), effects


def command(linear: float, angular: float = 0.0) -> PublishTwist:
    return PublishTwist(Twist(linear, angular))


def test_what_keeps_every_promise_is_clean() -> None:
    steps: list[tuple[Event, Sequence[Effect]]] = [
        (ModeRequested(1, 1, 1, "x"), [ModeChanged(IDLE, MOVING, ""), Reply(1, True, "", MOVING)]),
        tick(1, command(0.02, 0.08)),
        tick(2, command(0.04)),
        (
            ModeRequested(TICK_NS * 2 + 1, 2, 3, "x"),
            [
                command(0.0),
                LatchEmergencyStop(""),
                ModeChanged(MOVING, STOP, ""),
                Reply(2, True, "", STOP),
            ],
        ),
        tick(3, command(-0.0)),
        (
            ResetRequested(TICK_NS * 4, 3, "x"),
            [
                command(0.0),
                ReleaseEmergencyStop(),
                ModeChanged(STOP, IDLE, ""),
                Reply(3, True, "", IDLE),
            ],
        ),
    ]
    assert broken(IDLE, steps) == []


@for_each("mode", [IDLE, Mode.ERROR, STOP])
def test_a_motion_in_any_other_mode_than_moving_is_found(mode: Mode) -> None:
    assert broken(mode, [tick(1, command(0.001))]) == [
        f"a command of 0.001 m/s, 0 rad/s in {mode.name}"
    ]


@for_each("twist", [Twist(0.61, 0.0), Twist(0.0, -1.6), Twist(nan, 0.0), Twist(0.0, inf)])
def test_a_command_beyond_its_limits_is_found(twist: Twist) -> None:
    (found,) = broken(MOVING, [tick(1, PublishTwist(twist))])
    assert found.endswith("beyond 0.6 m/s, 1.5 rad/s")


@for_each("second", [command(0.0601), command(0.02, 0.2), command(-0.01)])
def test_a_command_that_changes_too_fast_is_found(second: PublishTwist) -> None:
    (found,) = broken(MOVING, [tick(1, command(0.02)), tick(2, second)])
    assert "within 0.020 s, beyond 1 m/s^2, 4 rad/s^2" in found


def test_a_step_to_zero_may_be_as_fast_as_it_can() -> None:
    steps = [tick(number, command(0.02 * number)) for number in range(1, 20)]
    assert broken(MOVING, [*steps, tick(20, command(0.0))]) == []


@for_each(
    ("effects", "message"),
    [
        ([], "request 7 has no reply"),
        ([Reply(7, True, "", IDLE)] * 2, "a reply to request 7, which is not open"),
        ([Reply(7, False, "", IDLE), Reply(8, True, "", IDLE)], "a reply to request 8"),
        ([Reply(7, True, "", MOVING)], "the reply to request 7 says MOVING in IDLE"),
        (
            [Reply(7, True, "", MOVING), ModeChanged(IDLE, MOVING, "")],
            "the reply to request 7 says MOVING in IDLE",
        ),
    ],
)
def test_a_request_without_its_one_true_reply_is_found(effects: list[Effect], message: str) -> None:
    found = broken(IDLE, [(ModeRequested(1, 7, 1, "x"), effects)])
    assert any(text.startswith(message) for text in found)


def test_an_emergency_stop_that_is_left_otherwise_is_found() -> None:
    released: list[Effect] = [command(0.0), ReleaseEmergencyStop()]
    battery = BatteryReceived(1, 1.0)
    assert broken(STOP, [(battery, [*released, ModeChanged(STOP, IDLE, "")])]) == [
        "EMERGENCY_STOP was left by a BatteryReceived, not by a reset"
    ]
    reset = ResetRequested(1, 1, "x")
    left: list[Effect] = [*released, ModeChanged(STOP, MOVING, ""), Reply(1, True, "", MOVING)]
    assert broken(STOP, [(reset, left)]) == ["EMERGENCY_STOP was left to MOVING, not to IDLE"]


def test_an_emergency_stop_that_is_not_latched_is_found() -> None:
    (found,) = broken(MOVING, [(BatteryReceived(1, 0.1), [ModeChanged(MOVING, STOP, "")])])
    assert found == "the mode is EMERGENCY_STOP, and the emergency stop is not latched"


def test_a_change_from_another_mode_than_the_present_is_found() -> None:
    (found,) = broken(IDLE, [tick(1, ModeChanged(MOVING, Mode.ERROR, ""))])
    assert found == "a change from MOVING, while the mode was IDLE"


def test_violations_are_counted_beyond_those_that_are_told() -> None:
    found = Invariants()
    found.snapshot(Snapshot("test", KernelParams(), State()))
    for number in range(100):
        found.step(number, Tick(number), (command(0.001),))
    assert (found.count, len(found.violations)) == (100, MAX_VIOLATIONS)


# The ledger


def test_a_ledger_that_does_not_add_up_is_found() -> None:
    counts = {"received": 10, "written": 8, "dropped": 1}
    assert list(unbalanced({"/odom": counts}, finished=False)) == []
    (sentence,) = unbalanced({"/odom": counts}, finished=True)
    assert sentence == "/odom: 10 messages received, but 8 written and 1 dropped"
    assert list(unbalanced({"/odom": {**counts, "dropped": 3}}, finished=False))
    assert not list(unbalanced({"/odom": {**counts, "dropped": 2}}, finished=True))
