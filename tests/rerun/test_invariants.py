"""Each invariant of the architecture is broken once, and the check finds it."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, nan

import pytest

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
from robotctl.rerun.invariants import MAX_VIOLATIONS, Invariants, unbalanced

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


@pytest.mark.parametrize("mode", [IDLE, Mode.ERROR, STOP])
def test_a_motion_in_any_other_mode_than_moving_is_found(mode: Mode) -> None:
    assert broken(mode, [tick(1, command(0.001))]) == [
        f"a command of 0.001 m/s, 0 rad/s in {mode.name}"
    ]


@pytest.mark.parametrize(
    "twist", [Twist(0.61, 0.0), Twist(0.0, -1.6), Twist(nan, 0.0), Twist(0.0, inf)]
)
def test_a_command_beyond_its_limits_is_found(twist: Twist) -> None:
    (found,) = broken(MOVING, [tick(1, PublishTwist(twist))])
    assert found.endswith("beyond 0.6 m/s, 1.5 rad/s")


@pytest.mark.parametrize("second", [command(0.0601), command(0.02, 0.2), command(-0.01)])
def test_a_command_that_changes_too_fast_is_found(second: PublishTwist) -> None:
    (found,) = broken(MOVING, [tick(1, command(0.02)), tick(2, second)])
    assert "within 0.020 s, beyond 1 m/s^2, 4 rad/s^2" in found


def test_a_step_to_zero_may_be_as_fast_as_it_can() -> None:
    steps = [tick(number, command(0.02 * number)) for number in range(1, 20)]
    assert broken(MOVING, [*steps, tick(20, command(0.0))]) == []


@pytest.mark.parametrize(
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
