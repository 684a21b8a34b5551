"""What the kernel says is told once, with commands that work when they are pasted."""

from __future__ import annotations

import re

import pytest

from robotctl.cli.registry import COMMANDS
from robotctl.ipc.advice import advice
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety import RULES, Finding, Rule
from robotctl.kernel.state import State
from robotctl.kernel.types import Cause, ModeRequested, Reply

SOURCE = "robotctl reset (uid 0, pid 7)"


def refusal_in(rule: Rule, reason: str) -> str:
    """Return what the kernel answers to a request to move while a rule holds the robot."""
    state = State(mode=rule.action, reason=reason, cause=rule.cause)
    (reply,) = Kernel(KernelParams(), state).step(ModeRequested(0, 1, Mode.MOVING, SOURCE))
    assert isinstance(reply, Reply)
    assert not reply.ok
    return reply.message


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.cause.value)
def test_the_cure_of_a_rule_is_told_once_at_the_end(rule: Rule) -> None:
    said = refusal_in(rule, Finding(rule, "something is wrong").text)
    told = advice(said, "robot")
    assert told.sentence.count(rule.cure) == 1
    assert told.cure.startswith(rule.cure)
    assert told.cause == f"moving is refused in {rule.action.name} (something is wrong)"


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.cause.value)
def test_every_command_names_the_robot(rule: Rule) -> None:
    said = refusal_in(rule, Finding(rule, "something is wrong").text)
    told = advice(said, "r2").sentence
    commands = re.findall(rf"robotctl (?:{'|'.join(COMMANDS)})\b( --robot r2)?", told)
    assert commands
    assert all(commands), told


def test_the_name_of_a_requester_is_left_alone() -> None:
    (rule,) = (rule for rule in RULES if rule.cause is Cause.OPERATOR_STOP)
    told = advice(refusal_in(rule, f"requested by {SOURCE}"), "r2")
    assert SOURCE in told.cause
    assert told.cure == "release it: robotctl reset --robot r2"


def test_a_text_without_a_cure_is_all_cause() -> None:
    assert advice("Mode changed to IDLE", "r2") == ("Mode changed to IDLE", "")
    moving = "the robot is MOVING: stop it first (robotctl set-mode idle)"
    assert advice(moving, "robot").sentence == moving
    assert "(robotctl set-mode idle --robot r2)" in advice(moving, "r2").sentence
