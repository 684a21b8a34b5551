"""The watchdog's thread: silent while the loop ticks, and in its place when it does not."""

from __future__ import annotations

import threading

import pytest

from robotctl.daemon.watchdog import CONFIRM_S, Watchdog
from robotctl.testing.world import DEADLINE_S, until


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
    return Watchdog(rate_hz, 0.3, gate, stalls.append), stalls


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
    looks: list[float] = []

    def starved() -> bool:
        looks.append(watchdog._silent_s())
        watchdog._ended.wait(0.01)
        return True

    monkeypatch.setattr(watchdog, "_is_starved", starved)
    with watchdog:
        watchdog.ping()
        until(lambda: stalls)
    assert len(looks) > 1
    assert max(looks) < 0.3  # then patience was over


def test_a_loop_that_starves_and_ticks_again_is_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gate = Gate()
    watchdog, stalls = watching(gate)
    ticked = threading.Event()

    def starved() -> bool:
        watchdog.ping()
        ticked.set()
        return True

    monkeypatch.setattr(watchdog, "_is_starved", starved)
    with watchdog:
        watchdog.ping()
        assert ticked.wait(DEADLINE_S)
    assert (gate.closed, stalls) == (0, [])


def test_a_thread_that_waits_is_not_starved() -> None:
    watchdog, _ = watching(Gate())
    starved: list[bool] = []
    asking = threading.Thread(target=lambda: starved.append(watchdog._is_starved()))
    asking.start()
    asking.join()  # waits meanwhile
    assert starved == [False]


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
    watchdog._last_ns = 0
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
