"""The daemon's small parts, each alone: dispatch, latch, lock."""

from __future__ import annotations

import os
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.daemon.control import Control
from robotctl.daemon.ending import stand_still
from robotctl.daemon.journal import Journal
from robotctl.daemon.latch import Latch
from robotctl.daemon.lock import owned
from robotctl.daemon.requests import Requests
from robotctl.errors import AlreadyRunning
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import (
    Effect,
    LatchEmergencyStop,
    ModeRequested,
    PublishTwist,
    Reply,
    ResetRequested,
    Tick,
)
from robotctl.recording.journal import JournalEntry, Kind, decode
from robotctl.replay.rerun import rerun

# Dispatch


class Bench:
    """A Control whose effects go where a test wants them."""

    def __init__(self) -> None:
        self.entries: list[JournalEntry] = []
        self.done: list[Effect] = []
        self.failures: list[str] = []
        self.do: Callable[[Effect], None] = self.done.append
        self.requests = Requests()
        self.control = Control(
            Kernel(KernelParams()),
            Journal(lambda serialized, seq: self.entries.append(decode(serialized))),
            lambda effect: self.do(effect),
            self.requests,
            lambda error, where: self.failures.append(where),
        )
        self.control.journal_snapshot(0)

    @property
    def names(self) -> list[str]:
        """What the journal holds."""
        return [entry.name for entry in self.entries]


def test_an_effect_is_journaled_after_it_was_carried_out() -> None:
    bench = Bench()
    seen: list[int] = []
    bench.do = lambda effect: seen.append(len(bench.entries))
    bench.control.dispatch(Tick(1))
    assert bench.names == ["Snapshot", "Tick", "PublishTwist"]
    assert seen == [2]


def test_a_snapshot_stands_in_the_journal_every_10_s() -> None:
    bench = Bench()
    for tick in range(1, 121):
        bench.control.dispatch(Tick(tick * 250_000_000))
    at_s = [entry.t_ns / 1e9 for entry in bench.entries if entry.kind is Kind.SNAPSHOT]
    assert at_s == [0.0, 10.0, 20.0, 30.0]
    assert rerun(bench.entries) is None


def test_what_an_effect_dispatches_waits_its_turn() -> None:
    bench = Bench()

    def carry_out(effect: Effect) -> None:
        if isinstance(effect, LatchEmergencyStop):
            bench.control.dispatch(Tick(2))

    bench.do = carry_out
    bench.control.dispatch(ModeRequested(1, 1, 3, "test"))
    assert bench.names[-3:] == ["Reply", "Tick", "PublishTwist"]
    assert rerun(bench.entries) is None


def test_the_effects_after_one_that_failed_are_carried_out_all_the_same() -> None:
    bench = Bench()

    def fail_to_publish(effect: Effect) -> None:
        if isinstance(effect, PublishTwist):
            raise OSError("no network")
        bench.done.append(effect)

    bench.do = fail_to_publish
    bench.control.dispatch(ModeRequested(1, 1, 3, "test"))
    assert [type(effect).__name__ for effect in bench.done] == [
        "LatchEmergencyStop",
        "ModeChanged",
        "Reply",
    ]
    reply = bench.done[-1]
    assert isinstance(reply, Reply)
    assert (reply.ok, reply.mode) == (False, Mode.EMERGENCY_STOP)
    assert reply.message.endswith("but PublishTwist failed: no network")
    assert rerun(bench.entries) is None


def test_a_failure_that_lasts_is_told_once_until_it_is_over() -> None:
    bench = Bench()
    broken = True

    def carry_out(effect: Effect) -> None:
        if broken:
            raise OSError("no network")

    bench.do = carry_out
    for t_ns in range(1, 4):
        bench.control.dispatch(Tick(t_ns))
    assert bench.failures == ["PublishTwist failed: no network"]
    broken = False
    bench.control.dispatch(Tick(4))
    broken = True
    bench.control.dispatch(Tick(5))
    assert len(bench.failures) == 2


async def test_a_request_that_nobody_waits_for_any_more_is_forgotten() -> None:
    bench = Bench()
    bench.requests.expect_reply(1).cancel()
    bench.requests.answer(Reply(1, True, "", Mode.IDLE))
    bench.do = lambda effect: bench.requests.answer(effect) if isinstance(effect, Reply) else None
    reply = await bench.control.request(ResetRequested(1, 2, "test"))
    assert (reply.request_id, reply.ok) == (2, True)


# The latch


async def test_a_latch_is_on_the_disk_before_it_is_confirmed(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "state" / "emergency-stop")
    assert latch.read() is None
    problems: list[str] = []
    latch.set("first")
    latch.set("second")
    latch.when_settled(problems.append)
    assert problems == []
    await latch.close()
    assert problems == [""]
    assert latch.read() == "second"
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
    latch.set("reason")
    latch.clear()
    await latch.close()
    written, named, removed = (False, False), (True, True), (True, False)
    assert synced == [written, named, removed]


async def test_a_latch_that_is_released_is_gone(tmp_path: Path) -> None:
    latch = Latch(tmp_path / "emergency-stop")
    latch.set("reason")
    latch.clear()
    await latch.close()
    assert latch.read() is None


async def test_a_latch_that_cannot_be_saved_says_why(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    latch = Latch(tmp_path / "file" / "emergency-stop")
    problems: list[str] = []
    latch.set("reason")
    latch.when_settled(problems.append)
    await latch.close()
    latch.when_settled(problems.append)  # as a second emergency stop does
    assert "the emergency-stop latch could not be saved" in problems[0]
    assert problems[1] == problems[0]


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"\0"])
def test_a_latch_that_a_power_cut_left_is_a_latched_stop(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "emergency-stop"
    path.write_bytes(content)
    assert Latch(path).read()


def test_a_latch_that_cannot_be_read_is_a_latched_stop(tmp_path: Path) -> None:
    (tmp_path / "emergency-stop").mkdir()
    assert "cannot be read" in str(Latch(tmp_path / "emergency-stop").read())


# The lock


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


# The end


async def test_no_motion_begins_while_the_daemon_ends() -> None:
    bench = Bench()
    bench.do = lambda effect: bench.requests.answer(effect) if type(effect) is Reply else None
    await stand_still(bench.control)
    reply = await bench.control.request(ModeRequested(time.monotonic_ns(), 1, 1, "test"))
    assert not reply.ok
    assert "the daemon is stopping" in reply.message
    assert rerun(bench.entries) is None
