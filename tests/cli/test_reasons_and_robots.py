"""Reasons of requests, and commands about every robot of a user, against fake daemons."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from robotctl.base.errors import UsageError
from robotctl.ipc.client import call

BAD_REASONS = ["x" * 10_000, "a\nb", "\x1b[2J", "\u202etxt"]


def mode() -> str:
    return str(call("robot", "status")["mode"])


@pytest.mark.parametrize("reason", BAD_REASONS, ids=["10 kB", "line", "escape", "direction"])
def test_a_reason_that_cannot_be_kept_is_refused_by_name_and_delays_no_stop(
    reason: str, daemon: None, cli: Callable[..., Any]
) -> None:
    for words in (("set-mode", "moving"), ("drive", "square"), ("reset",)):
        ran = cli(*words, "--reason", reason)
        assert (ran.exit_code, mode()) == (2, "IDLE")
        assert "--reason" in ran.err
    stopped = cli("estop", "--reason", reason)
    assert (stopped.exit_code, mode()) == (2, "EMERGENCY_STOP")
    assert "was stopped, but the reason was left out: --reason" in stopped.err


def test_a_reason_stands_where_the_mode_is_explained(daemon: None, cli: Callable[..., Any]) -> None:
    assert cli("estop", "--reason", "a child ran in").exit_code == 0
    assert call("robot", "status")["mode_reason"].endswith(": a child ran in")


@pytest.mark.parametrize("reason", BAD_REASONS, ids=["10 kB", "line", "escape", "direction"])
def test_the_socket_takes_no_such_reason_either(reason: str, daemon: None) -> None:
    with pytest.raises(UsageError, match=r"reason: .* without control characters"):
        call("robot", "set_mode", {"mode": 0, "source": "test", "reason": reason})


def test_estop_of_one_robot_names_the_others_that_move_and_all_stops_them(
    daemon: None, cli: Callable[..., Any]
) -> None:
    assert cli("start", "--robot", "r2").exit_code == 0
    for robot in ("robot", "r2"):
        assert cli("set-mode", "moving", "--robot", robot).exit_code == 0
    stopped = cli("estop")
    assert "still MOVING: r2 (all robots: robotctl estop --all)" in stopped.out
    assert json.loads(cli("estop", "--json").out)["others_moving"] == ["r2"]
    listed = {each["robot"]: each for each in json.loads(cli("ps", "--json").out)["robots"]}
    assert {name: each["mode"] for name, each in listed.items()} == {
        "r2": "MOVING",
        "robot": "EMERGENCY_STOP",
    }
    assert listed["r2"]["pid"]
    assert listed["r2"]["recording"].endswith(".mcap")
    everybody = cli("estop", "--all", "--reason", "fire")
    assert everybody.exit_code == 0
    assert sorted(line.split(":")[0] for line in everybody.out.splitlines()) == ["r2", "robot"]
    assert call("r2", "status")["mode"] == "EMERGENCY_STOP"
    assert "EMERGENCY_STOP" in cli("ps").out


@pytest.mark.usefixtures("home")
def test_where_no_daemon_runs_ps_says_so_and_a_stop_of_all_fails(cli: Callable[..., Any]) -> None:
    assert cli("ps").out == "no daemon runs\n"
    assert json.loads(cli("ps", "--json").out) == {"robots": []}
    assert cli("estop", "--all").exit_code == 3
