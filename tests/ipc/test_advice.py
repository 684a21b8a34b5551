"""A refusal tells its remedy once, with commands that work when they are pasted."""

from __future__ import annotations

import re

import pytest

from robotctl.cli.registry import COMMANDS
from robotctl.ipc.advice import advice, cure_of, for_robot
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.safety import RULE_OF, RULES, Rule
from robotctl.kernel.state import State
from robotctl.kernel.types import Cause, ModeRequested, Reply

SOURCE = "robotctl reset (uid 0, pid 7)"


def refusal_in(rule: Rule, reason: str) -> Reply:
    """Return what the kernel answers to a request to move while a rule holds the robot."""
    state = State(mode=rule.action, reason=reason, cause=rule.cause)
    (reply,) = Kernel(KernelParams(), state).step(ModeRequested(0, 1, Mode.MOVING, SOURCE))
    assert isinstance(reply, Reply)
    assert not reply.ok
    return reply


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.cause.value)
def test_a_refusal_has_its_cure_and_one_reset(rule: Rule) -> None:
    reply = refusal_in(rule, "something is wrong")
    told = advice(reply.message, reply.remedies, "robot")
    assert told.cause == f"moving is refused in {rule.action.name} (something is wrong)"
    assert told.cure.startswith(cure_of(rule.remedy, "robot"))
    assert told.sentence.count("robotctl reset") == 1


@pytest.mark.parametrize("remedy", Remedy)
def test_every_command_of_a_cure_names_the_robot(remedy: Remedy) -> None:
    cure = cure_of(remedy, "r2")
    assert cure
    commands = rf"robotctl (?:{'|'.join(COMMANDS)})\b(?: idle| call \S+ '[^']+')?( --robot r2)?"
    assert all(re.findall(commands, cure)), cure


def test_the_kernel_speaks_no_command_line() -> None:
    for rule in RULES:
        reply = refusal_in(rule, "something is wrong")
        assert "robotctl" not in reply.message
        assert "--" not in reply.message


def test_the_name_of_a_requester_is_left_alone() -> None:
    reply = refusal_in(RULE_OF[Cause.OPERATOR_STOP], f"requested by {SOURCE}")
    told = advice(reply.message, reply.remedies, "r2")
    assert SOURCE in told.cause
    assert told.cure == "release it: robotctl reset --robot r2"


def test_a_text_without_a_remedy_is_all_cause() -> None:
    assert advice("Mode changed to IDLE", (), "r2") == ("Mode changed to IDLE", "")


def test_commands_in_texts_of_other_parts_name_the_robot_once() -> None:
    assert for_robot("see robotctl logs", "robot") == "see robotctl logs"
    named = for_robot("see robotctl logs", "r2")
    assert named == for_robot(named, "r2") == "see robotctl logs --robot r2"
