"""The watchdog: silent while the loop ticks, and zeros while it does not."""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from robotctl.daemon.control.control_loop import (
    CONFIRM_S,
    SHOWN_FRAMES,
    ProcessorWait,
    Watchdog,
    where,
)
from robotctl.kernel.types import Cause, FaultReported, LoopStalled
from tests.support.waiting import DEADLINE_S, until


class Gate:
    """Counts instead of publishing; `broken` publications raise."""

    def __init__(self) -> None:
        self.closed = 0
        self.opened = 0
        self.zeros = 0
        self.broken = 0
        self.error: BaseException = RuntimeError("broken")

    def close_gate(self) -> None:
        self.closed += 1

    def publish_zero(self) -> None:
        if self.broken:
            self.broken -= 1
            raise self.error
        self.zeros += 1

    def open_gate(self) -> tuple[int, int]:
        self.opened += 1
        return self.zeros, 2


@pytest.fixture
def gate() -> Gate:
    return Gate()


def stall_of(watchdog: Watchdog) -> LoopStalled:
    """Wait for a stall, and take it."""
    found = until(watchdog.take)
    assert isinstance(found, LoopStalled)
    return found


def test_before_the_first_tick_nothing_is_watched(gate: Gate) -> None:
    with Watchdog(50.0, gate) as watchdog:
        assert "watchdog" not in {thread.name for thread in threading.enumerate()}
        assert watchdog.take() is None
    assert gate.closed == 0


def test_zeros_are_sent_from_the_last_tick_until_the_stall_is_taken(gate: Gate) -> None:
    with Watchdog(50.0, gate) as watchdog:
        watchdog.ping()
        until(lambda: gate.zeros > 3)
        assert (gate.closed, gate.opened) == (1, 0)
        zeros = gate.zeros
        stall = stall_of(watchdog)
        assert stall.zeros >= zeros
        assert stall.withheld == 2
        assert stall.stalled_s > 0.25
        assert gate.opened == 1
        assert watchdog.take() is None


def test_after_a_stall_the_loop_is_watched_again(gate: Gate) -> None:
    with Watchdog(50.0, gate) as watchdog:
        watchdog.ping()
        for _ in range(2):
            stall_of(watchdog)
    assert gate.closed == 2


def test_a_stall_without_a_later_tick_continues() -> None:
    now_ns = 0
    with Watchdog(50.0, Gate(), lambda: now_ns) as watchdog:
        watchdog.ping()
        for now_ns in (200_000_000, 500_000_000):  # another event came, but no tick
            assert stall_of(watchdog).stalled_s == now_ns / 1e9


def test_a_stall_within_a_tick_lasts_from_the_tick_before(gate: Gate) -> None:
    """The tick ends when the stall is over, and the next event takes the stall."""
    now_ns = 0
    with Watchdog(50.0, gate, lambda: now_ns) as watchdog:
        watchdog.ping()
        now_ns = 800_000_000
        until(lambda: gate.zeros > 0)
        watchdog.ping()
        now_ns = 801_000_000
        assert stall_of(watchdog).stalled_s == 0.801


class TickingEvent(threading.Event):
    """An event that is never set: each wait of the watchdog makes the loop tick."""

    watchdog: Watchdog

    def __init__(self, only_for_s: float | None = None) -> None:
        """`only_for_s`: only waits of this length make it tick."""
        super().__init__()
        self.only_for_s = only_for_s
        self.ticks = threading.Semaphore(0)

    def wait(self, timeout: float | None = None) -> bool:
        if self.only_for_s in (None, timeout):
            self.watchdog.ping()
            self.ticks.release()
        return super().wait(timeout if self.only_for_s else 0.001)


@pytest.mark.parametrize(
    ("rate_hz", "only_for_s", "ticks"),
    [(5.0, None, 100), (50.0, CONFIRM_S, 3)],  # at 5 Hz, ticks may be 0.5 s apart
    ids=["it ticks", "it catches up after a pause of the process"],
)
def test_a_loop_that_ticks_is_left_alone(
    gate: Gate, rate_hz: float, only_for_s: float | None, ticks: int
) -> None:
    ended = TickingEvent(only_for_s)
    ended.watchdog = Watchdog(rate_hz, gate, ended=ended)
    with ended.watchdog as watchdog:
        watchdog.ping()
        for _ in range(ticks):
            assert ended.ticks.acquire(timeout=DEADLINE_S)
    assert (gate.closed, gate.zeros) == (0, 0)


class VirtualTime(threading.Event):
    """A virtual clock: a wait advances it at once; the loop ticks at `ticks_ms`."""

    watchdog: Watchdog

    def __init__(self, ticks_ms: list[int]) -> None:
        super().__init__()
        self.now_ns = 0
        self.ticks_ms = ticks_ms
        self.over = threading.Event()

    def wait(self, timeout: float | None = None) -> bool:
        end_ns = self.now_ns + max(round((timeout or 0.0) * 1e9), 0)
        while self.ticks_ms and self.ticks_ms[0] * 1_000_000 <= end_ns:
            self.now_ns = self.ticks_ms.pop(0) * 1_000_000
            self.watchdog.ping()
        self.now_ns = end_ns
        if not self.ticks_ms:
            self.over.set()
        return not self.ticks_ms

    def run(self, rate_hz: float, gate: Gate) -> None:
        """Run a watchdog until the last tick."""
        self.watchdog = Watchdog(rate_hz, gate, lambda: self.now_ns, self)
        with self.watchdog:
            self.watchdog.ping()
            assert self.over.wait(DEADLINE_S), self.watchdog.take()  # why its thread has failed


@pytest.mark.parametrize(
    ("ticks_ms", "stalled"),
    [
        ([20, 130, 150], False),  # the check for the tick at 0 is at 100
        ([115, 130], False),
        ([20, 145, 165], True),
        ([125, 145], True),
    ],
)
def test_every_late_tick_is_given_its_confirmation(
    gate: Gate, ticks_ms: list[int], stalled: bool
) -> None:
    VirtualTime(ticks_ms).run(50.0, gate)
    assert bool(gate.closed) == stalled


def keeps_accounts() -> bool:
    """Return whether this Linux kernel has scheduler statistics."""
    account = Path("/proc/self/schedstat")
    return account.exists() and int(account.read_text().split()[0]) > 0


@pytest.mark.skipif(not keeps_accounts(), reason="the kernel keeps no account of its scheduler")
def test_a_thread_that_has_to_share_its_processor_has_waited() -> None:
    asked = ProcessorWait()
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})  # for this thread and its children
    try:
        with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as spinning:
            try:
                until(lambda: asked.waited_ns() > 1_000_000)
            finally:
                spinning.kill()
    finally:
        os.sched_setaffinity(0, cores)
        asked.close()


def test_a_stall_names_the_calls_that_held_the_loop_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ProcessorWait, "waited_ns", lambda _: 0)  # however busy the machine is
    with Watchdog(50.0, Gate()) as watchdog:
        watchdog.ping()
        stall = stall_of(watchdog)
    assert "(waiting.py:" in stall.detail


def test_a_stall_spent_waiting_for_a_processor_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with Watchdog(50.0, Gate()) as watchdog:
        watchdog.ping()
        monkeypatch.setattr(ProcessorWait, "waited_ns", lambda _: 10**12)
        stall = stall_of(watchdog)
    assert re.match(r"the machine was busy: no processor for \d+\.\d\d s", stall.detail)


def test_the_calls_of_a_stack_are_named_without_reading_source() -> None:
    code = compile(
        "import sys\ndef held():\n    return sys._getframe()\nframe = held()", "/x/y.py", "exec"
    )
    names: dict[str, object] = {}
    exec(code, names)
    frame: object = names["frame"]
    assert where(frame).startswith("held (y.py:3), called by <module> (y.py:4)")  # type: ignore[arg-type]
    assert where(frame).count("called by") == SHOWN_FRAMES - 1  # type: ignore[arg-type]
    assert where(None) == ""


@contextmanager
def no_descriptor_left() -> Iterator[None]:
    """Make every open fail in the block."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))  # with less, poll fails in other threads
    try:
        with pytest.raises(OSError, match="Too many open files"):
            os.open("/proc/self/stat", os.O_RDONLY)
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_without_a_free_descriptor_zeros_are_sent(gate: Gate) -> None:
    with Watchdog(50.0, gate) as watchdog, no_descriptor_left():
        watchdog.ping()
        until(lambda: gate.zeros > 3)
        assert stall_of(watchdog).zeros > 3


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_zero_that_cannot_be_sent_is_counted_and_followed_by_the_next(gate: Gate) -> None:
    gate.broken = 2
    with Watchdog(50.0, gate) as watchdog:
        watchdog.ping()
        until(lambda: gate.zeros > 1)
        assert "2 zeros could not be sent" in stall_of(watchdog).detail


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_watchdog_that_dies_is_one_fault(gate: Gate) -> None:
    gate.broken, gate.error = 1, SystemExit("out of everything")
    with Watchdog(50.0, gate) as watchdog:
        watchdog.ping()
        assert isinstance(stall_of(watchdog), LoopStalled)  # the gate must not stay closed
        fault = until(watchdog.take)
        assert isinstance(fault, FaultReported)
        assert fault.cause is Cause.TASK_DIED
        assert "the watchdog failed (SystemExit: out of everything)" in fault.detail
        assert watchdog.take() is None


@pytest.mark.parametrize(("rate_hz", "limit_ms"), [(1000.0, 100), (50.0, 100), (5.0, 500)])
@pytest.mark.parametrize(("late_ms", "stalled"), [(-1, False), (1, True)])
def test_slow_ticks_are_given_their_time(
    gate: Gate, rate_hz: float, limit_ms: int, late_ms: int, stalled: bool
) -> None:
    tick_ms = limit_ms + round(CONFIRM_S * 1000) + late_ms
    VirtualTime([tick_ms, tick_ms + 1]).run(rate_hz, gate)
    assert bool(gate.closed) == stalled
