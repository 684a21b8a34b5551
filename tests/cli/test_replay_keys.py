"""Keys steer a replay, and the terminal gets its settings back on every way out."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.geometry import Pose
from robotctl.recording.reader import Recording
from robotctl.replay.sight import Sight
from robotctl.replay.timeline import Span
from robotctl.testing.bags import LATCHED, START_NS, Line, write_bag
from robotctl.testing.waiting import DEADLINE_S

ODOMETRY, STATUS = "nav_msgs/msg/Odometry", "robot_controller/msg/RobotStatus"
ECHO_FLAGS = 3
CODE = "from robotctl.cli.app import main; main()"


def odometry(at_ms: float, x: float, *, endian: str = "<") -> Line:
    """Odometry at (x, 2 x), heading 0, with frame names that need padding."""
    data = b"\0\1\0\0" if endian == "<" else b"\0\0\0\0"
    data += struct.pack(f"{endian}iI", 1, 2)
    for name in (b"odom\0", b"base_link\0"):
        data += bytes(-len(data) % 4) + struct.pack(f"{endian}I", len(name)) + name
    data += bytes((4 - len(data)) % 8)
    data += struct.pack(
        f"{endian}7d36d6d36d", x, 2 * x, 0, 0, 0, 0, 1, *[0.0] * 36, 0.25, *[0] * 41
    )
    return Line("/odom", ODOMETRY, at_ms, data)


def status(at_ms: float, mode: int) -> Line:
    data = b"\0\1\0\0" + struct.pack("<I6sBxffB", 6, b"robot\0", mode, 0.5, 40.0, 1)
    return Line("/robot_status", STATUS, at_ms, data, LATCHED)


def drive(seconds: int) -> list[Line]:
    """A robot that drives straight on at 10 Hz."""
    return [status(0, 1), *(odometry(n * 100.0, n * 0.01) for n in range(10 * seconds))]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_bag(tmp_path / "run.mcap", drive(600))


class Terminal:
    """A command line on a terminal of its own."""

    def __init__(self, *arguments: object, program: tuple[str, ...] = (CODE,)) -> None:
        command = [sys.executable, "-c", *program, *map(str, arguments)]
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
        self.pid, self._file = pty.fork()
        if self.pid == 0:
            os.execve(command[0], command, environment)
        self._seen = ""

    def until(self, text: str) -> str:
        """Wait until the text is drawn from now on; returns what was drawn before it."""
        end = time.monotonic() + DEADLINE_S
        while not (found := re.search(text, self._seen)):
            assert time.monotonic() < end, self._seen[-2000:]
            if select.select([self._file], [], [], 0.1)[0]:
                self._seen += os.read(self._file, 65536).decode(errors="replace")
        before, self._seen = self._seen[: found.start()], self._seen[found.end() :]
        return before

    def press(self, keys: str) -> None:
        os.write(self._file, keys.encode())

    def is_cooked(self) -> bool:
        """Whether the terminal echoes and gives whole lines, as it did in the beginning."""
        flags = termios.tcgetattr(self._file)[ECHO_FLAGS]
        return bool(flags & termios.ECHO) and bool(flags & termios.ICANON)

    def end(self) -> int:
        """Wait for the process; returns its exit code."""
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            pid, found = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(found)
            with suppress(OSError):  # its output must go somewhere, and ends with it
                if select.select([self._file], [], [], 0.05)[0]:
                    self._seen += os.read(self._file, 65536).decode(errors="replace")
        raise AssertionError("the process did not end")

    def close(self) -> None:
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        os.close(self._file)


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
    viewing = terminal("replay", file, "--view-only", "--paused")
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
    viewing = terminal("replay", file, "--view-only")
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
"""Job control as a shell has it, for one command: stopped, continued by a line, ended."""


def test_ctrl_z_gives_the_terminal_back_and_fg_takes_it_again(terminal: Any, file: Path) -> None:
    shell = terminal("replay", file, "--view-only", program=(SHELL, CODE))
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
        [sys.executable, "-c", program, "replay", str(file), "--view-only", "--rate", "10"],
        capture_output=True,
        text=True,
    )
    lines = ran.stdout.splitlines()
    assert lines[-1] == "0", ran
    assert "MOVING  x 0" in lines[0]


# What is seen


def seen(tmp_path: Path, lines: list[Line], **options: Any) -> Sight:
    recording = Recording(write_bag(tmp_path / "run.mcap", lines))
    info = recording.info()
    span = Span(info.start_ns + options.get("skip_ms", 0) * 10**6, info.end_ns)
    return Sight(recording, span, loop=options.get("loop", False))


@pytest.mark.parametrize("endian", ["<", ">"])
def test_pose_velocity_and_path_are_those_of_the_moment(tmp_path: Path, endian: str) -> None:
    sight = seen(tmp_path, [odometry(n * 100.0, n * 1.0, endian=endian) for n in range(10)])
    sight.advance(350 * 10**6)
    assert sight.pose == Pose(3.0, 6.0, 0.0)
    assert sight.velocity is not None
    assert (sight.velocity.linear, sight.velocity.angular) == (0.25, 0.0)
    assert sight.path == [(float(n), 2.0 * n) for n in range(4)]
    assert sight.mode is None
    assert sight.next_ns == 400 * 10**6


def test_after_an_offset_the_mode_is_known_from_before_and_the_path_begins_there(
    tmp_path: Path,
) -> None:
    lines = [status(0, 3), *(odometry(n * 100.0, n * 1.0) for n in range(10))]
    sight = seen(tmp_path, lines, skip_ms=500)
    sight.advance(0)
    assert sight.mode == "EMERGENCY_STOP"
    sight.advance(10**10)
    assert sight.path == [(float(n), 2.0 * n) for n in range(4, 10)]
    assert sight.next_ns is None


def test_a_loop_begins_a_new_path(tmp_path: Path) -> None:
    sight = seen(tmp_path, [odometry(n * 100.0, n * 1.0) for n in range(5)], loop=True)
    sight.advance(399 * 10**6)
    assert len(sight.path) == 4
    sight.advance(550 * 10**6)
    assert sight.path == [(1.0, 2.0)]


def test_a_mode_of_another_version_is_shown_by_its_number(tmp_path: Path) -> None:
    sight = seen(tmp_path, [status(0, 9)])
    sight.advance(0)
    assert sight.mode == "mode 9"


@given(st.binary(max_size=900))
def test_no_message_can_break_the_view(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        lines = [
            Line("/odom", ODOMETRY, 0.0, content),
            Line("/robot_status", STATUS, 1.0, content),
        ]
        seen(Path(folder), lines).advance(START_NS)
