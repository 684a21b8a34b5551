"""`quick` calls exactly what typer would call."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robotctl.base.errors import UsageError
from robotctl.cli import quick, registry

NAMES = ["status", "set_mode", "estop", "reset", "stop"]

words = st.sampled_from(
    [
        "status",
        "set-mode",
        "estop",
        "reset",
        "stop",
        "start",
        "moving",
        "7",
        "--json",
        "--robot",
        "--reason",
        "--all",
        "smoke",
        "--robot=r2",
        "--robot=",
        "r2",
        "-h",
        "--help",
        "--no-json",
        "--js",
        "-x",
        "--",
        "-",
        "",
    ]
)


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


@pytest.mark.parametrize(
    "arguments", ["", "--help", "status --help", "status x", "set-mode", "--json status", "drive x"]
)
def test_everything_else_is_left_to_typer(arguments: str) -> None:
    assert quick.match(arguments.split()) is None


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
