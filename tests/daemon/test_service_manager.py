"""The daemon tells systemd that it is ready, alive and stopping."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest

from robotctl.daemon.service_manager import ServiceManager
from tests.support.waiting import DEADLINE_S
from tests.support.world import World


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
            "WATCHDOG_USEC": "2000000",
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


def test_without_systemd_nothing_is_told_and_a_lost_socket_stops_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    ServiceManager().ready()
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    manager = ServiceManager()
    assert "NOTIFY_SOCKET" not in os.environ
    manager.ready()
    manager.stopping()
    manager.close()
