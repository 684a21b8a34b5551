"""Run command lines in a temporary home, against a fake daemon that implements the protocol."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import robotctl
from robotctl.base.errors import NoDaemon
from robotctl.base.paths import recordings_note_path
from robotctl.base.processes import Child, start
from robotctl.cli import app
from robotctl.cli.targets import launch
from robotctl.cli.ui import text
from robotctl.ipc.client import Client
from tests.support.lines import Ran

FAKE_DAEMON = Path(__file__).with_name("fake_daemon.py")


Cli = Callable[..., Ran]
Spawn = Callable[..., subprocess.Popen[str]]


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Put sockets, logs and recordings below tmp_path, and use the fake daemon."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("PYTHONPATH", str(Path(robotctl.__file__).parent.parent))
    monkeypatch.delenv("ROBOTCTL_ROBOT", raising=False)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    monkeypatch.setattr(launch, "DAEMON", (sys.executable, str(FAKE_DAEMON)))
    (tmp_path / "cwd").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    started: list[int] = []

    def start_child(*arguments: Any, **options: Any) -> Child:
        child = start(*arguments, **options)
        started.append(child.pid)
        return child

    monkeypatch.setattr(launch, "start", start_child)
    yield tmp_path
    for pid in started:
        with suppress(ChildProcessError):  # it has been waited for: the number may be another's now
            if os.waitpid(pid, os.WNOHANG) == (0, 0):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
    for socket in (tmp_path / "run" / "robotctl").glob("*.sock"):
        try:
            with Client(socket.stem) as client:
                os.kill(client.daemon_pid, signal.SIGKILL)
        except NoDaemon:
            pass


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    """Run a command line in this process."""

    def run(*arguments: str) -> Ran:
        capsys.readouterr()
        exit_code = app.run(list(arguments))
        return Ran(exit_code, *capsys.readouterr())

    return run


def note_recordings(folder: Path, robot: str = "robot") -> Path:
    """Note the folder to which a robot's last daemon recorded; return the note."""
    note = recordings_note_path(robot)
    note.parent.mkdir(parents=True)
    note.write_text(f"{folder}\n")
    return note


@pytest.fixture
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Format lines as on a terminal of 200 columns."""
    monkeypatch.setattr(text, "_terminal_columns", lambda: 200)


@pytest.fixture
def daemon(cli: Cli) -> None:
    """Start a fake daemon for robot 'robot'; it runs until the test ends."""
    ran = cli("start")
    assert ran.exit_code == 0, ran.err


PROGRAM = """
import sys
from robotctl.cli import app
from robotctl.cli.targets import launch
from robotctl.cli.ui import text
launch.DAEMON = (sys.executable, sys.argv.pop(1))
app.main()
"""


@pytest.fixture
def command() -> list[str]:
    """Return the start of a command line that runs in its own process."""
    return [sys.executable, "-c", PROGRAM, str(FAKE_DAEMON)]


@pytest.fixture
def spawn(command: list[str]) -> Iterator[Spawn]:
    """Return a function that starts a command line in its own process, until the test ends."""
    started: list[subprocess.Popen[str]] = []

    def spawned(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        started.append(process)
        return process

    yield spawned
    for process in started:
        process.kill()
        process.communicate()
