"""Every command has --json, or a reason why no machine reads it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import typer

from robotctl.cli import registry

WITHOUT: dict[str, str] = {
    "completion show": "it prints a script that a shell reads",
    "completion words": "it answers a shell, one word a line",
    "plot": "it draws; `robotctl export --json` writes the numbers",
    "sim": "it runs the simulated robot until Ctrl-C",
    "teleop": "it is driven by hand, with keys or a gamepad, and draws a screen",
    "lease take": "its output is that of the command that it runs",
}


def commands() -> Iterator[tuple[str, Any]]:
    """Yield each command with its full name; a group only if it can be called by itself."""
    root: Any = typer.main.get_command(registry.app)
    context = root.make_context("robotctl", [], resilient_parsing=True)

    def walk(command: Any, name: str) -> Iterator[tuple[str, Any]]:
        is_group = hasattr(command, "list_commands")
        if name and (not is_group or command.invoke_without_command):
            yield name, command
        for inner in command.list_commands(context) if is_group else ():
            yield from walk(command.get_command(context, inner), f"{name} {inner}".strip())

    return walk(root, "")


COMMANDS = dict(commands())


def options_of(command: Any) -> set[str]:
    return {option for parameter in command.params for option in parameter.opts}


def test_the_walk_finds_groups_and_what_is_in_them() -> None:
    assert {"status", "recordings", "recordings rm", "topic echo"} <= set(COMMANDS)
    assert {name.split()[0] for name in COMMANDS} == set(registry.COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_has_json_or_a_reason(name: str) -> None:
    has_json = "--json" in options_of(COMMANDS[name])
    assert has_json == (name not in WITHOUT), f"{name}: give it --json, or a reason here"


def test_each_reason_is_that_of_a_command() -> None:
    assert set(WITHOUT) <= set(COMMANDS)
