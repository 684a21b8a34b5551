"""The live view on a terminal, and lines where there is none."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
from collections.abc import Callable
from typing import Any

import pytest

from robotctl.cli.view import plain_line
from robotctl.ipc.client import call


def test_through_a_pipe_it_prints_plain_lines(
    daemon: None, spawn: Callable[..., subprocess.Popen[str]]
) -> None:
    process = spawn("watch")
    assert process.stdout is not None
    for _ in range(2):
        line = process.stdout.readline()
        assert "IDLE" in line
        assert "x 0.500  y -0.250" in line
        assert "\x1b" not in line


def test_on_a_terminal_it_draws_within_80_columns(daemon: None, command: list[str]) -> None:
    controller, terminal = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
    process = subprocess.Popen(
        [*command, "watch"], stdin=terminal, stdout=terminal, stderr=terminal, env=environment
    )
    os.close(terminal)
    seen = ""
    while seen.count("robot  up") < 3:
        seen += os.read(controller, 65536).decode()
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 130
    os.close(controller)
    lines = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen).splitlines()
    assert max(len(line) for line in lines) <= 80
    for text in ("IDLE", "x +0.500 m", "87 %", "/odom", "recording", "\\x1b[2Jforged"):
        assert any(text in line for line in lines), text


def test_it_ends_with_the_daemon(
    daemon: None, cli: Callable[..., Any], spawn: Callable[..., subprocess.Popen[str]]
) -> None:
    process = spawn("watch")
    assert process.stdout is not None
    process.stdout.readline()
    assert cli("stop").exit_code == 0
    _, err = process.communicate(timeout=30)
    assert process.returncode == 3
    assert err.startswith("robotctl: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize("missing", ["pose", "battery", "velocity", "recorder"])
def test_what_is_not_known_yet_is_shown_as_unknown(missing: str, daemon: None) -> None:
    status = call("robot", "status")
    status[missing] = None
    assert "IDLE" in plain_line(status)
