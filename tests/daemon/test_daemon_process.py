"""One process a robot: its lock, its signals, what it reports, and its failed tasks."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from robotctl.base.errors import AlreadyRunning, RobotctlError
from robotctl.base.own_process import end_signals
from robotctl.daemon import supervisor
from robotctl.daemon.lock import owned
from robotctl.daemon.service_manager import ServiceManager
from robotctl.daemon.startup import StartReport
from robotctl.daemon.supervisor import MAX_DETAIL, Supervisor
from robotctl.kernel.types import Cause, Event, FaultReported
from tests.support.waiting import DEADLINE_S, loop_until
from tests.support.world import World


def test_a_lock_has_one_owner_names_it_and_is_free_after_it_failed(tmp_path: Path) -> None:
    path = tmp_path / "robot.lock"
    path.write_text("4194305 and more\n")

    def own_twice() -> None:
        with owned(path, "robot"), owned(path, "robot"):
            pass

    with pytest.raises(AlreadyRunning, match=f"pid {os.getpid()} "):
        own_twice()
    with owned(path, "robot"):
        assert path.read_text() == f"{os.getpid()}\n", "nothing is left of a longer pid"


def test_a_dead_owners_pid_is_not_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "robot.lock"
    monkeypatch.setattr("robotctl.daemon.lock.PID_S", 0.05)
    with owned(path, "r2"):
        path.write_text("4194305\n")  # above the highest pid of Linux
        with (
            pytest.raises(AlreadyRunning, match=r"pid unknown .*stop --robot r2"),
            owned(path, "r2"),
        ):
            pass


def test_an_owner_of_another_uid_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(pid: int, number: int) -> None:
        raise PermissionError

    path = tmp_path / "robot.lock"
    with owned(path, "robot"):
        monkeypatch.setattr(os, "kill", refuse)
        with pytest.raises(AlreadyRunning, match=f"pid {os.getpid()} "), owned(path, "robot"):
            pass


@pytest.fixture
def under_nohup() -> Iterator[None]:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
async def test_a_signal_ends_it(number: signal.Signals) -> None:
    told = end_signals()
    assert not told.is_set()
    os.kill(os.getpid(), number)
    await loop_until(told.is_set)


async def test_under_nohup_a_closed_terminal_does_not(under_nohup: None) -> None:
    told = end_signals()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    os.kill(os.getpid(), signal.SIGHUP)
    assert not told.is_set()
    os.kill(os.getpid(), signal.SIGTERM)
    await loop_until(told.is_set)


@pytest.fixture
def reported(monkeypatch: pytest.MonkeyPatch) -> list[Event]:
    monkeypatch.setattr(supervisor, "RESTART_S", 0.0)
    return []


async def die_once_of(error: Exception, told: list[Event]) -> str:
    """Run a task that fails and starts again; return the events for the kernel."""
    lives = iter([error])

    async def work() -> None:
        for death in lives:
            raise death

    watched = Supervisor(lambda: None)
    watched.report_to(told.append)
    await watched.run("test", work)
    (fault,) = told
    assert isinstance(fault, FaultReported)
    assert fault.cause is Cause.TASK_DIED
    return fault.detail


async def test_a_failed_task_is_reported_and_started_again(reported: list[Event]) -> None:
    assert (
        await die_once_of(ValueError("why"), reported) == "the test task failed (ValueError: why)"
    )


async def test_a_long_fault_is_shortened_for_the_journal_and_logged_whole(
    reported: list[Event], caplog: pytest.LogCaptureFixture
) -> None:
    words = "x" * 10 * MAX_DETAIL
    assert len(await die_once_of(ValueError(words), reported)) == MAX_DETAIL
    assert words in caplog.text


async def test_a_fault_before_the_kernel_exists_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR):
        Supervisor(lambda: None).callback_failed(ValueError("early"), "/odom")
    assert "the callback of /odom failed (ValueError: early)" in caplog.text


async def test_an_exception_in_the_loop_is_a_fault_and_anything_else_is_only_logged(
    reported: list[Event],
) -> None:
    watched, loop = Supervisor(lambda: None), asyncio.get_running_loop()
    watched.report_to(reported.append)
    watched.loop_failed(loop, {"message": "only words"})
    assert reported == []
    watched.loop_failed(loop, {"message": "seen", "exception": ValueError("why")})
    assert len(reported) == 1


@pytest.fixture
def ended() -> Iterator[list[int]]:
    """The signals that end this process."""
    numbers: list[int] = []
    before = signal.signal(signal.SIGTERM, lambda number, _: numbers.append(number))
    yield numbers
    signal.signal(signal.SIGTERM, before)


def report_without_reader() -> StartReport:
    reading, writing = os.pipe()
    os.close(reading)
    return StartReport(writing)


def test_a_daemon_that_no_command_waits_for_ends(ended: list[int]) -> None:
    report_without_reader().send({"ready": True})
    assert ended == [signal.SIGTERM]


def test_a_start_that_failed_keeps_its_exit_code(ended: list[int]) -> None:
    error = RobotctlError("no disk")
    assert report_without_reader().fail(error) == error.exit_code
    assert ended == []


def listener(path: Path) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    sock.bind(str(path))
    sock.settimeout(DEADLINE_S)
    return sock


def until_told(sock: socket.socket, wanted: str) -> list[str]:
    """Return what was told until a report held this line."""
    told: list[str] = []
    while wanted not in told:
        told += sock.recv(4096).decode().splitlines()
    return told


def test_a_daemon_reports_ready_mode_watchdog_and_its_end(world: World) -> None:
    with listener(world.folder / "notify") as sock:
        world.environment |= {
            "NOTIFY_SOCKET": str(world.folder / "notify"),
            "WATCHDOG_USEC": "500000",
        }
        daemon = world.spawn("start", "--foreground", "--sim")
        until_told(sock, "READY=1")
        world.ok("set-mode", "moving")
        until_told(sock, "STATUS=MOVING")
        until_told(sock, "WATCHDOG=1")
        daemon.send_signal(signal.SIGTERM)
        until_told(sock, "STOPPING=1")
        daemon.communicate(timeout=DEADLINE_S)
        assert daemon.returncode == 0


async def test_without_systemd_nothing_is_told_and_a_lost_socket_stops_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    ServiceManager().ready()
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    manager = ServiceManager()
    assert "NOTIFY_SOCKET" not in os.environ
    async with manager.reporting(lambda: "IDLE"):
        manager.ready()
