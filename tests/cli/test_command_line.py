"""What every command line does: the quick way, words of other tools, what is retired, --json."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robotctl.base import retired
from robotctl.base.errors import UsageError
from robotctl.cli import quick, registry
from robotctl.cli.app import behind_the_command
from robotctl.cli.registry import COMMANDS, other_words
from robotctl.kernel.patterns import PatternKind
from robotctl.kernel.types import ModeRequested
from robotctl.testing.drives import BEGIN_NS, drive, drive_requested, record
from tests.cli.conftest import Cli
from tests.support.bags import odometry, status, write_bag
from tests.support.lines import run_program

NAMES = ["status", "set_mode", "estop", "reset", "stop"]

WORDS = (
    "status set-mode estop reset stop start moving 7 --json --robot --reason --all smoke r2 -h -x"
)
WORDS += " --robot=r2 --robot= --help --no-json --js -- -"
words = st.sampled_from([*WORDS.split(), ""])


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Replace the actions, and return the list of their calls."""
    seen: list[Any] = []
    for name in NAMES:

        def record(*arguments: Any, name: str = name) -> None:
            seen.append((name, *arguments))

        monkeypatch.setattr(quick, name, record)
        if name in quick._WITHOUT_ARGUMENT:
            monkeypatch.setitem(quick._WITHOUT_ARGUMENT, name, record)
    return seen


def by_typer(arguments: list[str], calls: list[Any]) -> Any:
    """Return the call that typer makes, or None if it refuses the arguments."""
    calls.clear()
    try:
        registry.dispatch(arguments)
    except UsageError:
        return None
    return calls[0]


@pytest.mark.parametrize(
    ("arguments", "call"),
    [
        ("status", ("status", "robot", False)),
        ("status --json", ("status", "robot", True)),
        ("set-mode moving", ("set_mode", "moving", "robot", False, "")),
        ("set-mode --robot r2 IDLE --json", ("set_mode", "IDLE", "r2", True, "")),
        ("estop --robot r2", ("estop", "r2", False, "", False)),
        ("reset", ("reset", "robot", False, "")),
        ("estop --reason smoke", ("estop", "robot", False, "smoke", False)),
        ("estop --all", ("estop", "robot", False, "", True)),
        ("stop", ("stop", "robot", False)),
    ],
)
def test_what_is_spelt_plainly_takes_the_short_way(
    arguments: str, call: object, calls: list[Any]
) -> None:
    command = quick.match(arguments.split())
    assert command is not None
    command()
    assert calls == [call]
    assert by_typer(arguments.split(), calls) == call


@settings(
    max_examples=300,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(first=st.sampled_from(["status", "set-mode", "estop", "stop"]), rest=st.lists(words))
def test_both_ways_agree(first: str, rest: list[str], calls: list[Any]) -> None:
    arguments = [first, *rest]
    command = quick.match(arguments)
    if command is not None:
        calls.clear()
        command()
        quickly = calls[0]
        assert by_typer(arguments, calls) == quickly


@pytest.mark.parametrize("name", ["r2", ""])
def test_both_ways_take_the_robot_from_the_environment(
    name: str, calls: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOTCTL_ROBOT", name)
    command = quick.match(["estop"])
    assert command is not None
    command()
    assert calls == [("estop", name or "robot", False, "", False)]
    assert by_typer(["estop"], calls) == ("estop", name or "robot", False, "", False)


HEAVY = {"rclpy", "rich", "msgspec", "pydantic", "numpy", "mcap", "yaml", "asyncio"}

PROGRAM = """
import sys
from robotctl.cli.app import run
before = set(sys.modules)
assert run(sys.argv[1:]) == 0
print("imported", *{module.partition(".")[0] for module in sys.modules})
"""


def imported_by(*arguments: str) -> set[str]:
    """Return the top-level modules that a command line imports in a new interpreter."""
    program = [sys.executable, "-c", PROGRAM, *arguments]
    return set(run_program(*program).succeeded().splitlines()[-1].split()[1:])


def test_quick_commands_import_not_even_typer_and_others_no_heavy_library(daemon: None) -> None:
    for quick_line in ("status", "estop", "reset"):
        heavy = HEAVY | {"typer", "dataclasses", "inspect"}
        assert not imported_by(quick_line) & heavy, quick_line
    assert not imported_by("--help") & HEAVY
    assert not imported_by("drive", "square") & (HEAVY - {"pydantic"})


OFFLINE = """
import sys
from robotctl.cli.app import run
for words in ("replay bag.mcap --draw-only --rate 10", "replay run --check", "why run"):
    assert run(words.split()) == 0, words
assert not {"rclpy", "robotctl.ros", "robotctl.messages.definition", "numpy"} & set(sys.modules)
"""


def test_no_ros_is_imported_to_draw_check_or_explain_a_recording() -> None:
    estop = ModeRequested(BEGIN_NS + 500_000_000, 2, 3, "test")
    record(Path("run"), drive(1.0, requests=[drive_requested(), estop]))
    write_bag(Path("bag.mcap"), [status(0, 1), *(odometry(n * 100.0, n * 0.01) for n in range(9))])
    run_program(sys.executable, "-c", OFFLINE).succeeded()


@pytest.mark.parametrize("word", ["list", "kill", "run", "bag", "figure8", "rm", "circle"])
def test_a_word_of_another_tool_is_answered_with_the_command(word: str, cli: Cli) -> None:
    err = cli(word).refused(2)
    assert err == f"robotctl: No such command '{word}': {other_words()[word]}\n"


def test_every_pattern_is_such_a_word() -> None:
    assert {kind.value.replace("_", "-") for kind in PatternKind} <= set(other_words())


def test_the_words_are_no_commands_and_lead_to_commands_that_exist() -> None:
    assert not set(other_words()) & set(COMMANDS)
    root: Any = typer.main.get_command(registry.app)
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


def test_what_is_retired_names_what_replaces_it(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retired, "COMMANDS", {"steer": "use: robotctl drive"})
    monkeypatch.setattr(retired, "OPTIONS", {("info", "--steer"): "use: robotctl drive"})
    cli("steer", "left").failed(2, "use: robotctl drive")
    cli("info", "last", "--steer").failed(2, "--steer is retired: use: robotctl drive")


@pytest.mark.parametrize(
    ("line", "told"),
    [
        *((" ".join(words), told) for words, told in sorted(retired.OPTIONS.items())),
        *((f"{command} word", told) for command, told in sorted(retired.ARGUMENTS.items())),
    ],
)
def test_each_retired_option_and_argument_answers_so(line: str, told: str, cli: Cli) -> None:
    cli(*line.split()).failed(2, told)


def test_no_command_of_today_is_retired() -> None:
    assert not set(retired.COMMANDS) & set(COMMANDS)


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


WALKED = dict(commands())


def options_of(command: Any) -> set[str]:
    return {option for parameter in command.params for option in parameter.opts}


@pytest.mark.parametrize("name", WALKED)
def test_a_command_has_json_or_a_reason(name: str) -> None:
    has_json = "--json" in options_of(WALKED[name])
    assert has_json == (name not in WITHOUT), f"{name}: give it --json, or a reason here"


def test_each_reason_is_that_of_a_command() -> None:
    assert set(WITHOUT) <= set(WALKED)
