"""One daemon per robot: the lock and the pid in it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from robotctl.daemon.lock import owned
from robotctl.errors import AlreadyRunning


def test_a_lock_has_one_owner_and_names_it(tmp_path: Path) -> None:
    path = tmp_path / "robot.lock"
    with (
        owned(path, "robot"),
        pytest.raises(AlreadyRunning, match=f"pid {os.getpid()} "),
        owned(path, "robot"),
    ):
        pass
    with owned(path, "robot"):
        assert path.read_text() == f"{os.getpid()}\n"


def test_the_pid_of_an_owner_who_died_is_not_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "robot.lock"
    monkeypatch.setattr("robotctl.daemon.lock.PID_S", 0.05)
    with owned(path, "r2"):
        path.write_text("4194305\n")  # above the highest pid of Linux
        with (
            pytest.raises(AlreadyRunning, match=r"pid unknown .*stop --robot r2"),
            owned(path, "r2"),
        ):
            pass


def test_a_lock_is_free_after_an_owner_failed(tmp_path: Path) -> None:
    path = tmp_path / "robot.lock"

    def fail() -> Any:
        with owned(path, "robot"):
            raise RuntimeError("injected")

    with pytest.raises(RuntimeError):
        fail()
    with owned(path, "robot"):
        pass


def test_nothing_is_left_of_a_longer_pid(tmp_path: Path) -> None:
    path = tmp_path / "robot.lock"
    path.write_text("4194305 and more\n")
    with owned(path, "robot"):
        assert path.read_text() == f"{os.getpid()}\n"


def test_an_owner_under_another_uid_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(pid: int, number: int) -> None:
        raise PermissionError

    path = tmp_path / "robot.lock"
    with owned(path, "robot"):
        monkeypatch.setattr(os, "kill", refuse)
        with pytest.raises(AlreadyRunning, match=f"pid {os.getpid()} "), owned(path, "robot"):
            pass
