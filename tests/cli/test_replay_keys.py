"""Keys control a replay, and the terminal settings are restored in every case."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.bags import Line, odometry, status, write_bag
from tests.support.terminals import CODE, Terminal


def drive(seconds: int) -> list[Line]:
    """Return the messages at 10 Hz of a robot that drives straight ahead."""
    return [status(0, 1), *(odometry(n * 100.0, n * 0.01) for n in range(10 * seconds))]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_bag(tmp_path / "run.mcap", drive(600))


@pytest.fixture
def terminal() -> Iterator[Callable[..., Terminal]]:
    started: list[Terminal] = []

    def start(*arguments: object, **options: Any) -> Terminal:
        started.append(Terminal(*arguments, **options))
        return started[-1]

    yield start
    for each in started:
        each.close()


def test_keys_pause_step_and_change_the_rate(terminal: Any, file: Path) -> None:
    viewing = terminal("replay", file, "--draw-only", "--paused")
    viewing.until(r"0\.0 of 9 min 59 s +x1 +paused")
    viewing.press("n")
    viewing.press("n")
    viewing.until(r"0\.2 of .* paused")
    viewing.press("+")
    viewing.until(r"x1\.5 +paused")
    viewing.press("--")
    viewing.until(r"x0\.7 +paused")
    viewing.press(" ")
    viewing.until(r"\d\.\d of 9 min 59 s +x0\.7 +\r")
    assert not viewing.is_cooked()
    viewing.press("q")
    assert viewing.end() == 0
    assert viewing.is_cooked()


@pytest.mark.parametrize(
    ("number", "exit_code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGHUP, 130), (signal.SIGQUIT, 130)],
)
def test_a_signal_ends_it_and_the_terminal_is_as_before(
    number: signal.Signals, exit_code: int, terminal: Any, file: Path
) -> None:
    viewing = terminal("replay", file, "--draw-only")
    viewing.until("space pause")
    os.kill(viewing.pid, number)
    assert viewing.end() == exit_code
    assert viewing.is_cooked()


SHELL = """
import os, signal, sys, termios
signal.signal(signal.SIGTTOU, signal.SIG_IGN)
pid = os.fork()
if pid == 0:
    os.setpgid(0, 0)
    os.tcsetpgrp(0, os.getpid())
    signal.signal(signal.SIGTTOU, signal.SIG_DFL)
    os.execv(sys.executable, [sys.executable, "-c", *sys.argv[1:]])

def wait():
    _, status = os.waitpid(pid, os.WUNTRACED)
    os.tcsetpgrp(0, os.getpgrp())
    flags = termios.tcgetattr(0)[3]
    cooked = bool(flags & termios.ECHO) and bool(flags & termios.ICANON)
    said = "stopped" if os.WIFSTOPPED(status) else os.waitstatus_to_exitcode(status)
    print("SHELL:", said, cooked, flush=True)

wait()
sys.stdin.readline()
os.tcsetpgrp(0, pid)
os.kill(-pid, signal.SIGCONT)
wait()
"""
"""Job control of a shell for one command: it is stopped, continued by a line, and ends."""


def test_ctrl_z_gives_the_terminal_back_and_fg_takes_it_again(terminal: Any, file: Path) -> None:
    shell = terminal("replay", file, "--draw-only", program=(SHELL, CODE))
    shell.until(r"\d\.\d of 9 min")
    shell.press("\x1a")
    shell.until("SHELL: stopped True")
    shell.press("fg\n")
    shell.until("space pause")
    shell.press(" ")
    shell.until("paused")
    shell.press("q")
    shell.until("SHELL: 0 True")


def test_the_view_imports_nothing_of_ros(tmp_path: Path) -> None:
    file = write_bag(tmp_path / "run.mcap", drive(1))
    program = (
        "import sys; from robotctl.cli.app import run; code = run(sys.argv[1:]);"
        "print(code, *sorted(n for n in sys.modules if n in ('rclpy', 'numpy', 'robotctl.ros')))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program, "replay", str(file), "--draw-only", "--rate", "10"],
        capture_output=True,
        text=True,
    )
    lines = ran.stdout.splitlines()
    assert lines[-1] == "0", ran
    assert "MOVING  x 0" in lines[0]
