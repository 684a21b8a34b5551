"""The latch file: written before the stop is confirmed; an unreadable file is a stop."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest

from robotctl.base.errors import UsageError
from robotctl.daemon.control import latch as latch_module
from robotctl.daemon.control.latch import Latch, LatchedStop
from robotctl.kernel.types import Cause
from tests.support.waiting import loop_until

BY_OPERATOR = Cause.OPERATOR_STOP


async def test_a_latch_is_on_the_disk_before_it_is_confirmed(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "state" / "emergency-stop")
    assert latch.read() is None
    problems: list[str] = []
    latch.set("first", BY_OPERATOR)
    latch.set("second", Cause.BATTERY_LOW)
    latch.when_settled(problems.append)
    assert problems == []
    await latch.close()
    assert problems == [""]
    assert latch.read() == LatchedStop("second", Cause.BATTERY_LOW)
    assert [path.name for path in (tmp_path / "state").iterdir()] == ["emergency-stop"]


async def test_a_power_cut_leaves_the_old_latch_or_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, sync, synced = tmp_path / "emergency-stop", os.fsync, []

    def fsync(fd: int) -> None:
        synced.append((stat.S_ISDIR(os.fstat(fd).st_mode), path.exists()))
        sync(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    latch = Latch(path)
    latch.set("reason", BY_OPERATOR)
    latch.clear()
    await latch.close()
    written, named, removed = (False, False), (True, True), (True, False)
    assert synced == [written, named, removed]


async def test_a_latch_that_is_released_is_gone(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "emergency-stop")
    latch.set("reason", BY_OPERATOR)
    latch.clear()
    await latch.close()
    assert latch.read() is None


# Failures to save


@pytest.mark.parametrize("error", [OSError(30, "read-only"), UsageError("not yours"), KeyError(1)])
async def test_a_latch_that_cannot_be_saved_says_so_until_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    monkeypatch.setattr(latch_module, "RETRY_S", 0.01)
    failures, write = iter([error, error]), latch_module.write

    def fail_twice(path: Path, stop: LatchedStop) -> None:
        for failure in failures:
            raise failure
        write(path, stop)

    monkeypatch.setattr(latch_module, "write", fail_twice)
    latch = Latch(tmp_path / "emergency-stop")
    problems: list[str] = []
    latch.set("reason", BY_OPERATOR)
    latch.when_settled(problems.append)
    await loop_until(lambda: problems)
    assert "a restart would forget this stop: the emergency-stop latch could not" in problems[0]
    assert str(error) in problems[0]
    latch.when_settled(problems.append)  # as a second emergency stop does
    assert problems[1] == problems[0]
    assert latch.warning() == f"{problems[0]} (tried again each second)"
    await loop_until(lambda: latch.warning() == "")
    assert latch.read() == LatchedStop("reason", BY_OPERATOR)
    await latch.close()


async def test_a_stop_whose_thread_cannot_start_is_saved_as_soon_as_one_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latch_module, "RETRY_S", 0.01)
    start, starts = threading.Thread.start, 0

    def fail_twice(thread: threading.Thread) -> None:
        nonlocal starts
        starts += 1
        if starts <= 2:
            raise RuntimeError("can't start new thread")
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", fail_twice)
    latch = Latch(tmp_path / "emergency-stop")
    problems: list[str] = []
    latch.set("reason", BY_OPERATOR)
    latch.when_settled(problems.append)
    assert len(problems) == 1
    assert problems[0].startswith("a restart would forget this stop")
    assert "can't start new thread" in latch.warning()
    await loop_until(lambda: latch.warning() == "")
    assert latch.read() == LatchedStop("reason", BY_OPERATOR)
    await latch.close()


async def test_a_disk_that_hangs_delays_the_answer_for_a_moment_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latch_module, "DISK_S", 0.05)
    disk, write = threading.Event(), latch_module.write

    def hang(path: Path, stop: LatchedStop) -> None:
        disk.wait()
        write(path, stop)

    monkeypatch.setattr(latch_module, "write", hang)
    latch = Latch(tmp_path / "emergency-stop")
    problems: list[str] = []
    latch.set("reason", BY_OPERATOR)
    latch.when_settled(problems.append)
    await latch.close()  # does not wait for it either
    assert "has not answered for 0.05 s" in problems[0]
    assert "has not answered for 0.05 s" in latch.warning()
    disk.set()
    await loop_until(lambda: latch.warning() == "")
    assert len(problems) == 1


async def test_of_many_changes_during_one_write_each_is_answered_and_the_last_counts(
    tmp_path: Path,
) -> None:
    latch = Latch(tmp_path / "emergency-stop")
    answered: list[int] = []
    for number in range(100):
        latch.set(f"stop {number}", BY_OPERATOR)
        latch.when_settled(lambda problem, number=number: answered.append(number))  # type: ignore[misc]
    await latch.close()
    assert answered == list(range(100))
    assert latch.read() == LatchedStop("stop 99", BY_OPERATOR)


@pytest.mark.parametrize("name", ["emergency-stop", "emergency-stop.new"])
async def test_a_fifo_in_the_way_is_replaced_without_waiting(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    latch = Latch(tmp_path / "emergency-stop")
    problems: list[str] = []
    latch.set("reason", BY_OPERATOR)
    latch.when_settled(problems.append)
    await latch.close()
    assert problems == [""]
    assert latch.read() == LatchedStop("reason", BY_OPERATOR)


# Reading


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"\0", b"cause: battery l", b"cause: x"])
def test_a_latch_that_a_power_cut_left_is_a_stop_by_the_operator(
    tmp_path: Path, content: bytes
) -> None:
    path = tmp_path / "emergency-stop"
    path.write_bytes(content)
    stop = Latch(path).read()
    assert stop is not None
    assert stop.reason
    assert stop.cause is BY_OPERATOR


def test_a_latch_of_the_first_version_is_a_stop_by_the_operator(tmp_path: Path) -> None:
    path = tmp_path / "emergency-stop"
    path.write_text("requested by robotctl estop (uid 0, pid 1)")
    assert Latch(path).read() == ("requested by robotctl estop (uid 0, pid 1)", BY_OPERATOR)


async def test_a_reason_cannot_name_another_cause(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "emergency-stop")
    latch.set("mine\ncause: operator stop", Cause.BATTERY_LOW)
    await latch.close()
    assert latch.read() == ("mine cause: operator stop", Cause.BATTERY_LOW)


@pytest.fixture(params=["folder", "fifo", "device", "link to nothing"])
def unreadable(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "emergency-stop"
    match request.param:
        case "folder":
            path.mkdir()
        case "fifo":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case _:
            path.symlink_to(tmp_path / "nothing")
    return path


def test_a_latch_that_cannot_be_read_is_a_stop_by_the_operator(unreadable: Path) -> None:
    stop = Latch(unreadable).read()
    assert stop is not None
    assert f"the latch {unreadable} cannot be read: " in stop.reason
    assert stop.cause is BY_OPERATOR
