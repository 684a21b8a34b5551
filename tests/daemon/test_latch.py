"""The latch file: written before the stop is confirmed; an unreadable file is a stop."""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from robotctl.base.errors import UsageError
from robotctl.daemon.control import latch as latch_module
from robotctl.daemon.control.latch import Latch, LatchedStop
from robotctl.kernel.types import Cause
from tests.support.waiting import loop_until

BY_OPERATOR = Cause.OPERATOR_STOP


class AskedLatch(Latch):
    """A latch that is asked for its problem when it is set; `problems` are the answers."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.problems: list[str] = []

    def stop(self) -> None:
        self.set("reason", BY_OPERATOR)
        self.when_settled(self.problems.append)


@pytest.fixture
def latch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AskedLatch:
    monkeypatch.setattr(latch_module, "RETRY_S", 0.01)
    return AskedLatch(tmp_path / "emergency-stop")


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
    latch: AskedLatch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, synced = os.fsync, []

    def fsync(fd: int) -> None:
        is_there = (tmp_path / "emergency-stop").exists()
        synced.append((stat.S_ISDIR(os.fstat(fd).st_mode), is_there))
        sync(fd)

    monkeypatch.setattr(os, "fsync", fsync)
    latch.set("reason", BY_OPERATOR)
    latch.clear()
    await latch.close()
    written, named, removed = (False, False), (True, True), (True, False)
    assert synced == [written, named, removed]


async def test_a_latch_that_is_released_is_gone(latch: AskedLatch) -> None:
    latch.set("reason", BY_OPERATOR)
    latch.clear()
    await latch.close()
    assert latch.read() is None


@pytest.mark.parametrize("error", [OSError(30, "read-only"), UsageError("not yours"), KeyError(1)])
async def test_a_latch_that_cannot_be_saved_says_so_until_it_is(
    latch: AskedLatch, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    failures, write = iter([error, error]), latch_module.write

    def fail_twice(path: Path, stop: LatchedStop) -> None:
        for failure in failures:
            raise failure
        write(path, stop)

    monkeypatch.setattr(latch_module, "write", fail_twice)
    latch.stop()
    await loop_until(lambda: latch.problems)
    told = latch.problems[0]
    assert "a restart would forget this stop: the emergency-stop latch could not" in told
    assert str(error) in told
    latch.when_settled(latch.problems.append)  # as a second emergency stop does
    assert latch.problems[1] == told
    assert latch.warning() == f"{told} (tried again each second)"
    await loop_until(lambda: latch.warning() == "")
    assert latch.read() == LatchedStop("reason", BY_OPERATOR)
    await latch.close()


async def test_a_stop_whose_thread_cannot_start_is_saved_as_soon_as_one_can(
    latch: AskedLatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, failures = threading.Thread.start, iter([RuntimeError("can't start new thread")] * 2)

    def fail_twice(thread: threading.Thread) -> None:
        for failure in failures:
            raise failure
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", fail_twice)
    latch.stop()
    (told,) = latch.problems
    assert told.startswith("a restart would forget this stop")
    assert "can't start new thread" in latch.warning()
    await loop_until(lambda: latch.warning() == "")
    assert latch.read() == LatchedStop("reason", BY_OPERATOR)
    await latch.close()


async def test_a_disk_that_hangs_delays_the_answer_for_a_moment_only(
    latch: AskedLatch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(latch_module, "DISK_S", 0.05)
    disk, write = threading.Event(), latch_module.write

    def hang(path: Path, stop: LatchedStop) -> None:
        disk.wait()
        write(path, stop)

    monkeypatch.setattr(latch_module, "write", hang)
    latch.stop()
    await latch.close()  # does not wait for it either
    assert "has not answered for 0.05 s" in latch.problems[0]
    assert "has not answered for 0.05 s" in latch.warning()
    disk.set()
    await loop_until(lambda: latch.warning() == "")
    assert len(latch.problems) == 1


async def test_of_many_changes_during_one_write_each_is_answered_and_the_last_counts(
    latch: AskedLatch,
) -> None:
    answered: list[int] = []
    for number in range(100):
        latch.set(f"stop {number}", BY_OPERATOR)
        latch.when_settled(lambda problem, number=number: answered.append(number))  # type: ignore[misc]
    await latch.close()
    assert answered == list(range(100))
    assert latch.read() == LatchedStop("stop 99", BY_OPERATOR)


@pytest.mark.parametrize("name", ["emergency-stop", "emergency-stop.new"])
async def test_a_fifo_in_the_way_is_replaced_without_waiting(
    latch: AskedLatch, tmp_path: Path, name: str
) -> None:
    os.mkfifo(tmp_path / name)
    latch.stop()
    await latch.close()
    assert latch.problems == [""]
    assert latch.read() == LatchedStop("reason", BY_OPERATOR)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"\0", b"cause: battery l", b"cause: x"])
def test_a_latch_that_a_power_cut_left_is_a_stop_by_the_operator(
    latch: AskedLatch, tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "emergency-stop").write_bytes(content)
    stop = latch.read()
    assert stop is not None
    assert stop.reason
    assert stop.cause is BY_OPERATOR


def test_a_latch_of_the_first_version_is_a_stop_by_the_operator(
    latch: AskedLatch, tmp_path: Path
) -> None:
    reason = "requested by robotctl estop (uid 0, pid 1)"
    (tmp_path / "emergency-stop").write_text(reason)
    assert latch.read() == (reason, BY_OPERATOR)


async def test_a_reason_cannot_name_another_cause(latch: AskedLatch) -> None:
    latch.set("mine\ncause: operator stop", Cause.BATTERY_LOW)
    await latch.close()
    assert latch.read() == ("mine cause: operator stop", Cause.BATTERY_LOW)


@pytest.mark.parametrize(
    "put",
    [
        Path.mkdir,
        os.mkfifo,
        lambda path: path.symlink_to("/dev/zero"),
        lambda path: path.symlink_to("nothing"),
    ],
    ids=["folder", "fifo", "device", "link to nothing"],
)
def test_a_latch_that_cannot_be_read_is_a_stop_by_the_operator(
    latch: AskedLatch, tmp_path: Path, put: Callable[[Path], None]
) -> None:
    put(tmp_path / "emergency-stop")
    stop = latch.read()
    assert stop is not None
    assert f"the latch {tmp_path / 'emergency-stop'} cannot be read: " in stop.reason
    assert stop.cause is BY_OPERATOR
