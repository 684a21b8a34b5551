"""Words that people bring are answered with a command, and common options may stand first."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
import typer

from robotctl.cli import quick
from robotctl.cli.app import behind_the_command
from robotctl.cli.registry import COMMANDS, app, other_words
from robotctl.kernel.patterns import PatternKind


@pytest.mark.parametrize("word", ["list", "kill", "run", "bag", "figure8", "rm", "circle"])
def test_a_word_of_another_tool_is_answered_with_the_command(
    word: str, cli: Callable[..., Any]
) -> None:
    ran = cli(word)
    assert (ran.exit_code, ran.out) == (2, "")
    assert ran.err == f"robotctl: No such command '{word}': {other_words()[word]}\n"


def test_every_pattern_is_such_a_word() -> None:
    assert {kind.value.replace("_", "-") for kind in PatternKind} <= set(other_words())


def test_the_words_are_no_commands_and_lead_to_commands_that_exist() -> None:
    assert not set(other_words()) & set(COMMANDS)
    root: Any = typer.main.get_command(app)
    for text in other_words().values():
        for line in re.findall(r"`robotctl ([^`]+)`", text):
            words = line.split()
            command = root.get_command(None, words[0])
            assert command is not None, line
            if hasattr(command, "commands") and words[1:]:
                assert words[1] in command.commands, line


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("--robot r2 status", "status --robot r2"),
        ("--json --robot=r2 topic list", "topic list --json --robot=r2"),
        ("--robot r2 replay f -- x", "replay f --robot r2 -- x"),
        ("--robot r2 start --ros-args -p a:=1", "start --robot r2 --ros-args -p a:=1"),
        ("--json", "--json"),
        ("--robot", "--robot"),
        ("--robot status", "--robot status"),
        ("--json --version", "--json --version"),
        ("--debug-x status", "--debug-x status"),
        ("status --robot r2", "status --robot r2"),
        ("", ""),
    ],
)
def test_common_options_may_stand_before_the_command(given: str, meant: str) -> None:
    assert behind_the_command(given.split()) == meant.split()


def test_an_emergency_stop_with_the_robot_first_takes_the_short_way() -> None:
    assert quick.match(behind_the_command(["--robot", "r2", "estop"])) is not None


def test_the_error_names_the_robot_that_was_given_first(cli: Callable[..., Any]) -> None:
    ran = cli("--robot", "r2", "status")
    assert (ran.exit_code, "robot 'r2'" in ran.err) == (3, True)
