"""The live view on a terminal, and lines where there is none."""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import subprocess
import threading
from collections.abc import Iterator
from io import StringIO
from typing import Any

import pytest
from rich.console import Console

from robotctl.base.errors import Refused
from robotctl.cli.commands import status as watch
from robotctl.cli.targets.driving import Background
from robotctl.cli.ui.panels import History, drive_map, live_view
from robotctl.ipc.answers import DrivenPath
from robotctl.ipc.client import call
from tests.cli.conftest import Cli, Spawn
from tests.support.lines import line_of
from tests.support.terminals import Terminal


def test_through_a_pipe_it_prints_rows_or_objects_and_ends_with_the_daemon(
    daemon: None, cli: Cli, spawn: Spawn
) -> None:
    rows, objects = spawn("watch"), spawn("watch", "--json")
    assert line_of(rows.stdout) == f"{watch.HEADER}\n"
    for _ in range(2):
        line = line_of(rows.stdout)
        assert " ".join(line.split()[1:]) == "IDLE 0.500 -0.250 1.500 0.200 87% 20 0"
        assert "\x1b" not in line
        assert json.loads(line_of(objects.stdout))["mode"] == "IDLE"
    assert cli("stop").exit_code == 0
    _, err = rows.communicate(timeout=30)
    assert rows.returncode == 3
    assert err.startswith("robotctl: ")
    assert err.count("\n") == 1


def test_a_row_has_80_columns_and_shows_what_is_not_known(daemon: None) -> None:
    status = call("robot", "status")
    far = status | {
        "uptime_s": 86_400.0,
        "mode": "EMERGENCY_STOP",
        "pose": {"x": -999.999, "y": -999.999, "theta": -3.141},
        "velocity": {"linear": -1.234},
        "battery": 1.0,
        "recorder": {"written": 10_000_000, "lost": 9999},
    }
    row = watch.status_line(far)
    assert len(row) == len(watch.HEADER) == 80
    assert " ".join(row.split()) == (
        "86400.0 EMERGENCY_STOP -999.999 -999.999 -3.141 -1.234 100% 10000000 9999"
    )
    for missing in ("pose", "battery", "velocity"):
        assert "IDLE" in watch.status_line(status | {missing: None})
        live_view(status | {missing: None})
    observer = status | dict.fromkeys(("mode", "pose", "velocity", "battery"))
    assert " ".join(watch.status_line(observer).split()[1:]) == "observing - - - - - 20 0"


def test_on_a_terminal_it_draws_within_80_columns(daemon: None, command: list[str]) -> None:
    controller, terminal = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
    process = subprocess.Popen(
        [*command, "watch"], stdin=terminal, stdout=terminal, stderr=terminal, env=environment
    )
    os.close(terminal)
    seen = ""
    while seen.count("robot  up") < 3:
        seen += os.read(controller, 65536).decode(errors="ignore")
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 130
    os.close(controller)
    seen = seen.replace("\x1b[H", "\n")
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen).splitlines()
    assert max(len(line) for line in lines) <= 80
    for text in ("IDLE", "x +0.500 m", "87 %", "/odom", "recording", "\\x1b[2Jforged"):
        assert any(text in line for line in lines), text


def test_a_failed_poll_does_not_end_the_view_of_a_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    done = threading.Event()
    polls: Iterator[Refused | dict[str, Any]] = iter(
        [Refused("busy with 64 clients"), {"mode": "MOVING"}]
    )

    def poll(robot: str, method: str) -> dict[str, Any]:
        found = next(polls)
        if isinstance(found, Refused):
            raise found
        return found

    monkeypatch.setattr(watch, "call", poll)
    monkeypatch.setattr(watch, "LINE_S", 0.0)
    driving = Background(lambda: {"waited": done.wait()})
    driving.start()
    for status in watch.polled_until(driving, "robot"):
        assert status["mode"] == "MOVING"
        done.set()
        driving.join()
    assert driving.result() == {"waited": True}


@pytest.mark.parametrize(
    ("key", "mode", "told"),
    [(" ", "IDLE", "stopped with a ramp"), ("e", "EMERGENCY_STOP", "emergency stop, released")],
)
def test_a_key_stops_the_robot(key: str, mode: str, told: str, daemon: None) -> None:
    call("robot", "set_mode", {"mode": 1, "source": "test"})
    watching = Terminal("watch")
    try:
        watching.until("MOVING")
        watching.press(key)
        watching.until(told)
        assert call("robot", "status")["mode"] == mode
        watching.press("q")
        assert watching.end() == 0
        assert watching.is_cooked()
    finally:
        watching.close()


def test_an_error_is_drawn_only_while_it_is_measured() -> None:
    path: DrivenPath = {"reference": [], "driven": [[0.0, 0.0], [1.0, 1.0]]}
    history, drawn = History(), []
    for drive in ({"cross_track_m": 0.1}, {"cross_track_m": None}, None):
        history.add({"velocity": {"linear": 0.2}, "drive": drive})
        output = StringIO()
        Console(width=38, file=output).print(drive_map(path, history, 24))
        assert "speed" in output.getvalue()
        drawn.append("error" in output.getvalue())
    assert drawn == [True, False, False]
