"""The watchdog's thread: silent while the loop ticks, and in its place when it does not."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from robotctl.daemon.processor_time import ProcessorTime
from robotctl.daemon.watchdog import CONFIRM_S, Turn, Watchdog
from robotctl.testing.waiting import DEADLINE_S, until

PATIENCE_S = 0.3


class Gate:
    """Counts instead of publishing; `broken` publications raise."""

    def __init__(self) -> None:
        self.closed = 0
        self.zeros = 0
        self.broken = 0

    def close_gate(self) -> None:
        self.closed += 1

    def publish_zero(self) -> None:
        if self.broken:
            self.broken -= 1
            raise RuntimeError("broken")
        self.zeros += 1


def watching(gate: Gate, rate_hz: float = 50.0) -> tuple[Watchdog, list[str]]:
    stalls: list[str] = []
    return Watchdog(rate_hz, PATIENCE_S, gate, stalls.append), stalls


def test_before_the_first_tick_nothing_is_watched() -> None:
    gate = Gate()
    watchdog, stalls = watching(gate)
    with watchdog:
        assert "watchdog" not in {thread.name for thread in threading.enumerate()}
    assert (gate.closed, stalls) == (0, [])


def test_a_loop_that_stops_ticking_is_stopped_once_and_zeros_go_on() -> None:
    gate = Gate()
    watchdog, stalls = watching(gate)
    with watchdog:
        watchdog.ping()
        until(lambda: gate.zeros > 3)
        assert (gate.closed, len(stalls)) == (1, 1)


def test_after_it_was_taken_the_loop_is_watched_again() -> None:
    gate = Gate()
    watchdog, stalls = watching(gate)
    with watchdog:
        watchdog.ping()
        for count in (1, 2):
            until(lambda count=count: len(stalls) == count)
            watchdog.taken()
    assert gate.closed == 2


def test_a_loop_that_ticks_is_left_alone() -> None:
    gate = Gate()
    watchdog, stalls = watching(gate, rate_hz=5.0)  # ticks may be 0.5 s apart
    looks = threading.Semaphore(0)
    wait = watchdog._ended.wait

    def counted(timeout: float | None = None) -> bool:
        watchdog.ping()
        looks.release()
        return wait(0.001)

    watchdog._ended.wait = counted  # type: ignore[method-assign]
    with watchdog:
        watchdog.ping()
        for _ in range(100):
            assert looks.acquire(timeout=DEADLINE_S)
    assert (gate.closed, gate.zeros, stalls) == (0, 0, [])


def test_a_starved_loop_is_given_its_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate()
    watchdog, stalls = watching(gate)
    looks: list[int] = []

    def starved(_: ProcessorTime) -> bool:
        looks.append(watchdog._silent_ns())
        return True

    monkeypatch.setattr(ProcessorTime, "is_starved", starved)
    with watchdog:
        watchdog.ping()
        until(lambda: stalls)
    assert len(looks) > 1
    assert float(stalls[0].split()[-2]) >= PATIENCE_S


def test_the_time_for_which_the_loop_waited_for_a_processor_does_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    watchdog, stalls = watching(Gate())
    waited_ns = [0, *range(0, 10**12, 10**12 // 100)]
    monkeypatch.setattr(ProcessorTime, "waited_ns", lambda _: waited_ns.pop(0))
    with watchdog:
        watchdog.ping()
        until(lambda: stalls)
    assert float(stalls[0].split()[-2]) >= PATIENCE_S


def test_a_loop_that_starves_and_ticks_again_is_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gate = Gate()
    watchdog, stalls = watching(gate)
    ticked = threading.Event()

    def starved(_: ProcessorTime) -> bool:
        watchdog.ping()
        ticked.set()
        return True

    monkeypatch.setattr(ProcessorTime, "is_starved", starved)
    with watchdog:
        watchdog.ping()
        assert ticked.wait(DEADLINE_S)
    assert (gate.closed, stalls) == (0, [])


class VirtualTime:
    """In which a loop ticks at `ticks_ms`, and the watchdog's waits take no time of ours."""

    def __init__(self, watchdog: Watchdog, ticks_ms: list[int]) -> None:
        self.now_ns = 0
        self._watchdog = watchdog
        self._ticks_ms = ticks_ms

    def now(self) -> Turn:
        return Turn(self.now_ns, 0)

    def wait(self, timeout: float) -> bool:
        end_ns = self.now_ns + max(round(timeout * 1e9), 0)
        while self._ticks_ms and self._ticks_ms[0] * 1_000_000 <= end_ns:
            self.now_ns = self._ticks_ms.pop(0) * 1_000_000
            self._watchdog._last = self.now()
        self.now_ns = end_ns
        return not self._ticks_ms


@pytest.mark.parametrize(
    ("ticks_ms", "stalled"),
    [
        ([0, 20, 130, 150], False),  # the look that the tick at 0 asked for is at 100
        ([0, 115, 130], False),
        ([0, 20, 145, 165], True),
        ([0, 125, 145], True),
    ],
)
def test_every_late_tick_is_given_its_confirmation(
    ticks_ms: list[int], stalled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ProcessorTime, "is_starved", lambda _: False)
    gate = Gate()
    watchdog, stalls = watching(gate)
    virtual = VirtualTime(watchdog, ticks_ms)
    with watchdog:
        watchdog._now = virtual.now  # type: ignore[method-assign]
        watchdog._ended.wait = virtual.wait  # type: ignore[method-assign]
        watchdog._watch()
    assert bool(stalls) == stalled


def test_a_thread_that_waits_is_not_starved() -> None:
    asked = ProcessorTime()
    starved: list[bool] = []
    asking = threading.Thread(target=lambda: starved.append(asked.is_starved()))
    asking.start()
    asking.join()  # waits meanwhile
    asked.close()
    assert starved == [False]


def keeps_accounts() -> bool:
    """Whether the kernel counts what its scheduler does: not all are built so."""
    account = Path("/proc/self/schedstat")
    return account.exists() and int(account.read_text().split()[0]) > 0


@pytest.mark.skipif(not keeps_accounts(), reason="the kernel keeps no account of its scheduler")
def test_a_thread_that_has_to_share_its_processor_has_waited() -> None:
    asked = ProcessorTime()
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})  # of this thread, and of those that it starts
    try:
        spinning = subprocess.Popen([sys.executable, "-c", "while True: pass"])
        try:
            until(lambda: asked.waited_ns() > 1_000_000)
        finally:
            spinning.kill()
            spinning.wait()
    finally:
        os.sched_setaffinity(0, cores)
        asked.close()


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_zero_that_cannot_be_sent_is_followed_by_the_next() -> None:
    gate = Gate()
    gate.broken = 2
    watchdog, stalls = watching(gate)
    with watchdog:
        watchdog.ping()
        until(lambda: gate.zeros > 1)
    assert len(stalls) == 1


@pytest.mark.parametrize(("rate_hz", "limit_s"), [(1000.0, 0.1), (50.0, 0.1), (5.0, 0.5)])
def test_slow_ticks_are_given_their_time(rate_hz: float, limit_s: float) -> None:
    watchdog, _ = watching(Gate(), rate_hz)
    assert watchdog._limit_ns == round(limit_s * 1e9)


def test_a_loop_that_catches_up_after_a_pause_of_the_process_is_left_alone() -> None:
    gate = Gate()
    watchdog, stalls = watching(gate)
    caught_up = threading.Semaphore(0)
    wait = watchdog._ended.wait

    def paused(timeout: float | None = None) -> bool:
        if timeout == CONFIRM_S:
            watchdog.ping()
            caught_up.release()
        return wait(timeout)

    watchdog._ended.wait = paused  # type: ignore[method-assign]
    with watchdog:
        watchdog.ping()
        for _ in range(3):
            assert caught_up.acquire(timeout=DEADLINE_S)
    assert (gate.closed, gate.zeros, stalls) == (0, 0, [])
