"""A gate passes the commands of one owner, and closes until that owner commands zero."""

from __future__ import annotations

import pytest

from robotctl.kernel.types import ZERO, Twist
from robotctl.ros.executables.command_gate import SILENCE_S, CommandGate

OWNER, OTHER = b"o" * 16, b"x" * 16
FORWARD = Twist(0.5, 0.0)
NOW = 10**9
SILENCE_NS = round(SILENCE_S * 1e9)


def opened() -> CommandGate:
    """A gate whose owner has commanded zero at NOW."""
    gate = CommandGate()
    gate.look([OWNER], "", NOW)
    assert gate.passes(OWNER, ZERO, 0, NOW)
    return gate


def test_the_owners_commands_pass_and_no_others() -> None:
    gate = opened()
    assert gate.passes(OWNER, FORWARD, 0, NOW)
    assert gate.passes(OTHER, FORWARD, 0, NOW) is None
    assert gate.closed_because(NOW) == ""


def test_a_gate_that_is_started_again_revives_no_motion() -> None:
    gate = CommandGate()
    gate.look([OWNER], "", NOW)
    assert gate.passes(OWNER, FORWARD, 0, NOW) is False
    assert gate.closed_because(NOW) == "the owner of the mode has not commanded zero yet"
    assert gate.passes(OWNER, ZERO, 0, NOW)
    assert gate.passes(OWNER, FORWARD, 0, NOW)


def test_zeros_are_due_after_the_silence_of_the_owner_and_it_must_begin_with_zero() -> None:
    gate = opened()
    assert not gate.needs_zero(NOW + SILENCE_NS)
    later = NOW + SILENCE_NS + 1
    assert gate.needs_zero(later)
    assert gate.closed_because(later) == "the owner of the mode is silent"
    assert gate.passes(OWNER, FORWARD, 0, later) is False
    assert gate.passes(OWNER, ZERO, 0, later)


@pytest.mark.parametrize("age_ns", [SILENCE_NS + 1, -SILENCE_NS - 1])
def test_a_command_that_was_held_up_does_not_pass(age_ns: int) -> None:
    gate = opened()
    assert gate.passes(OWNER, FORWARD, age_ns, NOW) is False
    assert gate.passes(OWNER, FORWARD, 0, NOW) is False


@pytest.mark.parametrize(
    ("owners", "others", "why"),
    [
        ([OWNER, OTHER], "", "2 nodes command this gate"),
        ([OWNER], "/teleop publishes /cmd_vel too", "/teleop publishes /cmd_vel too"),
        ([], "", "the owner of the mode is gone"),
    ],
)
def test_whatever_is_not_one_owner_alone_closes_it(
    owners: list[bytes], others: str, why: str
) -> None:
    gate = opened()
    gate.look(owners, others, NOW)
    assert gate.closed_because(NOW) == why
    assert not gate.passes(OWNER, FORWARD, 0, NOW)
    gate.look([OWNER], "", NOW)
    assert not gate.passes(OWNER, FORWARD, 0, NOW), "a zero must come first"


def test_an_owner_that_comes_after_another_begins_with_zero() -> None:
    gate = opened()
    gate.look([OTHER], "", NOW)
    assert gate.passes(OWNER, FORWARD, 0, NOW) is None
    assert gate.passes(OTHER, FORWARD, 0, NOW) is False
    assert gate.passes(OTHER, ZERO, 0, NOW)


def test_two_owners_at_once_command_nothing() -> None:
    gate = CommandGate()
    gate.look([OWNER, OTHER], "", NOW)
    assert not gate.passes(OWNER, ZERO, 0, NOW)
    assert not gate.had_owner


def test_without_any_owner_no_zeros_are_due() -> None:
    gate = CommandGate()
    gate.look([], "", NOW)
    assert not gate.needs_zero(NOW + 10 * SILENCE_NS)
    assert gate.closed_because(NOW) == ""
