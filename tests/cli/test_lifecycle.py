"""start, stop, logs and view: start returns when the daemon is ready, or says why it failed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from robotctl import __version__
from robotctl.base.errors import NoDaemon
from robotctl.base.paths import lock_path, log_path
from robotctl.cli.commands import logs, start
from robotctl.cli.targets import launch
from robotctl.daemon.lock import owned
from robotctl.ipc.client import call
from tests.cli.conftest import Cli, Spawn
from tests.support.lines import line_of
from tests.support.waiting import until


def children() -> set[int]:
    """Return our child processes, including ended ones that were not waited for."""
    ids = Path(f"/proc/self/task/{os.getpid()}/children").read_text()
    return {int(pid) for pid in ids.split()}


def test_start_returns_when_the_daemon_answers_and_says_what_runs(cli: Cli) -> None:
    out = cli("start", "--domain-id", "7").succeeded()
    pid = call("robot", "status")["pid"]
    assert os.getsid(pid) == pid, "it outlives its terminal"
    lines = out.splitlines()
    assert lines[0] == f"robotctl {__version__}: robot robot is ready"
    for text in ("IDLE", "domain 7, discovery LOCALHOST", "yes", "robot.sock", "daemon.log"):
        assert any(text in line for line in lines)
    assert "  recording   recordings/robot_20260101_120000/robot_20260101_120000_0.mcap" in lines
    assert f"  pid         {pid}" in lines
    assert "note: a sourced ROS (humble) was left out" in lines


def test_a_latched_stop_is_told_with_its_release(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_MODE", "EMERGENCY_STOP")
    out = cli("start", "--robot", "r2").out
    assert "the emergency stop is still latched; release it with: robotctl reset --robot r2" in out


def test_the_options_reach_the_daemon_and_json_is_what_it_said(cli: Cli) -> None:
    options = ["--config=a.yaml", "--recordings=r", "--drive=circle", "--no-sim"]
    said = cli("start", *options, "--json").summary
    assert (said["ready"], said["pid"]) == (True, call("robot", "status")["pid"])
    logged = cli("logs").out
    for option in options:
        assert f"'{option}'" in logged


@pytest.mark.parametrize(
    ("failure", "exit_code", "text"),
    [
        ("refuse", 2, "robotctl: robot.yaml: speed: nan is not allowed\n"),
        ("run-already", 5, "robotctl: robot 'robot' is already running (pid 4711)\n"),
        ("crash", 1, "ended with exit code 1 before it was ready: ZeroDivisionError: a bug"),
        ("garbage", 1, "ended with exit code 3 before it was ready: its log is empty"),
    ],
)
def test_a_failed_start_says_why_and_leaves_nothing_running(
    failure: str, exit_code: int, text: str, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_START", failure)
    before = children()
    cli("start").refused(exit_code, text)
    assert children() == before


def test_a_start_without_a_folder_for_its_log_names_the_cure(
    cli: Cli, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (home / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(home / "file"))
    err = cli("start").refused(2)
    assert err == (
        f"robotctl: {home}/file is not a folder: set XDG_STATE_HOME to a folder of yours\n"
    )


def test_a_daemon_that_is_never_ready_is_ended(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_START", "hang")
    monkeypatch.setattr(launch, "READY_DEADLINE_S", 0.05)
    before = children()
    cli("start").failed(1, "was not ready within")
    assert children() == before


def test_a_start_that_crashes_leaves_the_log_of_a_running_daemon_in_place(
    cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = log_path("robot")
    with owned(lock_path("robot"), "robot"):
        log.parent.mkdir(parents=True, mode=0o700)
        log.write_text("of the daemon that runs\n")
        monkeypatch.setenv("FAKE_START", "crash")
        failed = log.with_name("daemon.log.failed")
        cli("start").failed(1, f"(see: {failed})")
    assert log.read_text() == "of the daemon that runs\n"
    assert "a bug before READY" in failed.read_text()
    assert sorted(log.parent.iterdir()) == [log, failed]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interruption_while_starting_leaves_nothing_running(
    number: signal.Signals, spawn: Spawn, monkeypatch: pytest.MonkeyPatch, home: Path
) -> None:
    monkeypatch.setenv("FAKE_START", "hang")
    process = spawn("start")
    daemons = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not (pids := daemons.read_text().split()):
        assert process.poll() is None
    until(lambda: b"fake_daemon" in Path(f"/proc/{pids[0]}/cmdline").read_bytes())
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (130, "")
    assert not Path(f"/proc/{pids[0]}").exists()
    assert list((home / "state").glob("robotctl/robot/*")) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_daemon_that_is_ready_but_was_not_told_of_ends_with_its_start(
    number: signal.Signals, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = children()

    def interrupted(ready: dict[str, Any]) -> Iterator[str]:
        os.kill(os.getpid(), number)
        yield "ready"

    monkeypatch.setattr(start, "summary", interrupted)
    assert cli("start").exit_code == 130
    assert children() == before
    with pytest.raises(NoDaemon):
        call("robot", "status")


def test_foreground_becomes_the_daemon(spawn: Spawn) -> None:
    process = spawn("start", "--foreground", "--robot", "r2")
    assert "--ready-fd" not in line_of(process.stdout)
    assert call("r2", "status")["pid"] == process.pid
    call("r2", "stop")
    assert process.wait(30) == 0


def test_foreground_is_not_combined_with_json(spawn: Spawn) -> None:
    process = spawn("start", "--foreground", "--json")
    out, _ = process.communicate(timeout=30)
    assert process.returncode == 2
    assert json.loads(out)["error"]["kind"] == "usage"


def test_the_log_of_the_run_before_is_kept(cli: Cli) -> None:
    for robot_run in range(3):
        assert cli("start", "--recordings", f"run{robot_run}").exit_code == 0
        assert cli("stop").exit_code == 0
    log = log_path("robot")
    assert "run2" in log.read_text()
    assert "run1" in log.with_name("daemon.log.1").read_text()
    names = sorted(path.name for path in log.parent.glob("daemon.log*"))
    assert names == ["daemon.log", "daemon.log.1"]


def test_a_second_start_leaves_the_running_daemons_log_alone(
    daemon: None, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = log_path("robot")
    before = log.stat().st_ino
    for failure, exit_code in (("run-already", 5), ("refuse", 2)):
        monkeypatch.setenv("FAKE_START", failure)
        assert cli("start").exit_code == exit_code
        assert log.stat().st_ino == before
        assert [path.name for path in log.parent.glob("daemon.log*")] == ["daemon.log"]


def test_logs_shows_control_characters_escaped_and_no_colours(daemon: None, cli: Cli) -> None:
    assert "in red\n" in cli("logs").out
    with log_path("robot").open("a") as log:
        log.write("\x1b[2Jcleared\x1b[1;31m\x07\n")
    assert "\\x1b[2Jcleared\\x07\n" in cli("logs").out


def following(path: Path, monkeypatch: pytest.MonkeyPatch, *steps: Callable[[], Any]) -> list[str]:
    """Return the lines that `logs -f` prints, with one of these events at each of its waits."""
    todo = iter(steps)

    class Enough(Exception):
        pass

    def wait(_: float) -> None:
        step = next(todo, None)
        if step is None:
            raise Enough
        step()

    monkeypatch.setattr("robotctl.cli.commands.logs.time.sleep", wait)

    def lines() -> Iterator[str]:
        try:
            yield from logs._lines(path, follow=True)
        except Enough:
            return

    return list(lines())


def test_logs_f_awaits_the_rest_of_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log"
    log.write_text("one\ntw")

    def append(text: str) -> None:
        with log.open("a") as file:
            file.write(text)

    lines = following(log, monkeypatch, lambda: append("o\nth"), lambda: append("ree\n"))
    assert lines == ["one", "two", "three"]


def test_logs_f_goes_on_with_the_next_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log"
    log.write_text("old\n")

    def restart() -> None:
        log.rename(tmp_path / "log.1")
        log.write_text("new\n")

    assert following(log, monkeypatch, restart) == ["old", "new"]


LOG = """\
2026-01-01 12:00:00,250 INFO robotctl: ready
2026-01-01 12:00:01,500 ERROR robotctl.ros: lost
    the second line of it
2026-13-01 12:00:02,000 INFO robotctl: no such month
"""


@pytest.fixture
def logged() -> None:
    path = log_path("robot")
    path.parent.mkdir(parents=True)
    path.write_text(LOG)


@pytest.mark.usefixtures("logged")
def test_logs_shows_the_last_or_newest_lines(cli: Cli) -> None:
    for arguments, count in (("", 4), ("-n 2", 2), ("-n 0", 0), ("-n 9", 4)):
        ran = cli("logs", *arguments.split())
        assert (ran.exit_code, len(ran.out.splitlines())) == (0, count)
        assert LOG.endswith(ran.out)
    assert len(cli("logs", "--since", "2026-01-01T12:00:01").out.splitlines()) == 2
    cli("logs", "--since", "soon").failed(2, "--since soon is not a time")


@pytest.mark.usefixtures("logged")
def test_logs_for_machines_is_an_object_for_each_line(cli: Cli) -> None:
    first, error, more, odd = map(json.loads, cli("logs", "--json").out.splitlines())
    assert (first["level"], first["logger"], first["text"]) == ("INFO", "robotctl", "ready")
    assert error["t_ns"] - first["t_ns"] == 1_250_000_000
    assert more == {
        "t_ns": error["t_ns"],
        "level": None,
        "logger": None,
        "text": "    the second line of it",
    }
    assert odd["t_ns"] is None


def test_logs_f_begins_with_the_last_lines(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text(LOG)
    begin = logs._begin_of_last(log, 1)
    assert next(logs._lines(log, follow=True, begin=begin)) == LOG.splitlines()[-1]


def test_the_daemon_is_not_imported_from_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "json.py").write_text("raise SystemExit('shadowed')")
    monkeypatch.undo()
    command = launch.daemon_command("robot", {}, ())
    program = [*command[: command.index("-m")], "-c", "import json; print(json.__file__)"]
    ran = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True)
    assert ran.stdout.strip().startswith(str(Path(os.__file__).parent)), ran.stderr
    assert command[0] == sys.executable


def test_wrong_options_are_refused_at_once(cli: Cli) -> None:
    cli("view", "--port", "99999").failed(2, "--port 99999")


def test_without_the_extra_the_cure_is_told(cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, "find_spec", lambda name: None)
    cli("view").failed(4, "pip install 'robotctl[view]'")
