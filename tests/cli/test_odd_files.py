"""A file that is not regular is refused at once; no command waits for a FIFO."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotctl.base.errors import ConfigError, UsageError
from robotctl.config import load
from robotctl.daemon.command_line import parse
from robotctl.testing.drives import drive, record
from tests.cli.conftest import Cli
from tests.support.waiting import DEADLINE_S

RECORDING = "run"

READERS = ["info", "replay --check", "replay --draw-only", "replay --resim", "why", "recover"]
READERS += ["clip"]


@pytest.fixture(autouse=True)
def no_command_hangs() -> Iterator[None]:
    """Let a test that would wait for a writer fail instead."""

    def give_up(*_: object) -> None:
        raise AssertionError("it waits for a writer")

    previous = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(int(DEADLINE_S))
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, previous)


@pytest.fixture
def run(cli: Cli) -> Cli:
    """Run a command line that must end with one sentence and no unexpected error."""

    def ran(*arguments: str) -> Any:
        came = cli(*arguments)
        assert "unexpected" not in came.err
        return came

    return ran


@pytest.mark.parametrize("command", READERS)
def test_a_fifo_is_no_recording(command: str, run: Cli) -> None:
    Path("folder").mkdir()
    for fifo in ("fifo", "fifo.mcap", "folder/a.mcap"):
        os.mkfifo(fifo)
    for name in ("fifo", "fifo.mcap", "folder"):
        ran = run(*command.split(), name)
        assert ran.exit_code in (4, 6), ran
        assert ran.err.count("\n") == 1
        assert "No such file" not in ran.err
        assert name in ran.err + ran.out


@pytest.mark.parametrize(
    ("command", "exit_code"), [("info", 6), ("replay --check", 6), ("why", 4), ("recover", 0)]
)
def test_a_list_of_files_that_is_a_fifo_is_told_and_the_files_are_read(
    command: str, exit_code: int, run: Cli
) -> None:
    recording = record(Path(RECORDING), drive(1.0))
    (recording / "metadata.yaml").unlink(missing_ok=True)
    os.mkfifo(recording / "metadata.yaml")
    ran = run(*command.split(), RECORDING)
    assert ran.exit_code == exit_code, ran  # 4: it was not stopped
    assert ("not a regular file" in ran.out + ran.err) is (command != "recover")


def test_a_fifo_among_the_recordings_hides_no_other(run: Cli) -> None:
    record(Path("recordings") / "robot_20260101_000000", drive(1.0))
    os.mkfifo("recordings/robot_20260102_000000")
    Path("recordings/robot_20260103_000000").mkdir()
    os.mkfifo("recordings/robot_20260103_000000/robot_20260103_000000_0.mcap")
    run("recordings").succeeded("robot_20260101_000000", "unreadable")


@pytest.mark.parametrize("path", ["fifo", "/dev/zero", "."])
def test_a_configuration_is_a_file(path: str) -> None:
    os.mkfifo("fifo")
    with pytest.raises(ConfigError, match=f"{path}: .*: give the path of a YAML file"):
        load(Path(path))


@pytest.fixture
def gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the working folder."""
    folder = tmp_path / "gone"
    folder.mkdir()
    monkeypatch.chdir(folder)
    folder.rmdir()


@pytest.mark.parametrize(
    "arguments",
    [
        *("info x", "info last", "recordings", "recordings keep x", "clip", "recover x", "why"),
        "replay x",
    ],
)
def test_a_working_folder_that_is_gone_is_named(arguments: str, gone: None, run: Cli) -> None:
    err = run(*arguments.split()).refused(2)
    assert err == "robotctl: the working folder was removed: cd to a folder that exists\n"


@pytest.mark.parametrize("arguments", ["status", "estop", "reset", "stop", "mark x", "logs"])
def test_what_needs_no_working_folder_runs_without_it(arguments: str, gone: None, run: Cli) -> None:
    run(*arguments.split()).failed(3)


def test_a_daemon_without_a_working_folder_says_what_it_needs(gone: None, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="the working folder was removed: cd to a folder that ex"):
        parse([])
    assert parse(["--recordings", str(tmp_path)]).recordings == tmp_path


@pytest.fixture
def closed() -> Iterator[Path]:
    """Create a folder that other users cannot read."""
    base = Path(tempfile.mkdtemp(prefix="rt-", dir="/tmp"))
    base.chmod(0o755)
    (base / "closed" / "run").mkdir(parents=True)
    (base / "closed").chmod(0o700)
    yield base / "closed" / "run"
    shutil.rmtree(base)


ANOTHER_USER = """
import contextlib, io, json, os, sys
from robotctl.cli import app

def ran(line, state):
    os.environ |= {"XDG_RUNTIME_DIR": state, "XDG_STATE_HOME": state}
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        return app.run(line.split()), said.getvalue()

lines = json.loads(sys.argv[1])
for each in lines:
    ran(*each)
os.setresuid(65533, 65533, 65533)
print(json.dumps([ran(*each) for each in lines]))
"""
"""Imports as root first, because the modules may be in a folder that only root can read."""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_what_may_not_be_read_is_named(closed: Path) -> None:
    readers = ["info {}", "replay --check {}", "why {}", "recover {}", "clip {} --at 0.5"]
    readers += ["recordings --recordings {}"]
    lines = [(line.format(closed), str(closed.parent.parent)) for line in readers]
    lines += [("logs", str(closed)), ("status", str(closed))]
    program = [sys.executable, "-c", ANOTHER_USER, json.dumps(lines)]
    done = subprocess.run(program, capture_output=True, text=True, timeout=DEADLINE_S)
    assert done.returncode == 0, done.stderr
    for (line, _), (exit_code, said) in zip(lines, json.loads(done.stdout), strict=True):
        assert exit_code != 0, line
        assert str(closed.parent) in said, line
        assert "Permission denied" in said or "another user" in said, line
        assert "Traceback" not in said
        assert "unexpected" not in said
