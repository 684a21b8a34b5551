"""A pool polls its sources, rests in between, and survives their exceptions."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.qos import HistoryPolicy, QoSProfile

from robotctl.ros.executor import runtime as pool_module
from robotctl.ros.executor.event_loop import NS_PER_S, beat_before
from robotctl.ros.executor.runtime import Pool
from robotctl.ros.executor.sources.subscriptions import affordable_rest_s

Until = Callable[[Callable[[], object]], Awaitable[None]]


def test_a_flooded_pool_rests_for_less_until_it_is_calm(monkeypatch: pytest.MonkeyPatch) -> None:
    clock: Any = SimpleNamespace(now_ns=10**9, monotonic_ns=lambda: clock.now_ns)
    monkeypatch.setattr(pool_module, "time", clock)
    monkeypatch.setattr(pool_module, "beat_before", lambda until_ns: until_ns)
    rests: list[float] = []

    class Loop:
        add_reader = remove_reader = staticmethod(lambda *_: None)
        is_closed = staticmethod(lambda: False)

        def call_at(self, at_s: float, _: object) -> None:
            rests.append(round(at_s - clock.now_ns / 1e9, 6))

    class Source:
        taking_ns: tuple[int, ...] = ()

        def poll(self) -> bool:
            clock.now_ns += self.taking_ns[0]
            self.taking_ns = self.taking_ns[1:]
            return bool(self.taking_ns)

    loop: Any = Loop()
    source, pool = Source(), Pool(loop, 0.03)

    def rests_after(passed_ms: int, *taking_ms: float) -> list[float]:
        clock.now_ns += passed_ms * 1_000_000
        source.taking_ns = tuple(round(ms * 1e6) for ms in taking_ms)
        rests.clear()
        for _ in taking_ms:
            pool._poll()
        return rests

    with os.fdopen(os.eventfd(1), "rb", 0) as ready:
        pool.add(ready.fileno(), source)
        assert rests_after(1000, 0.5) == [0.03]
        assert rests_after(30, 0.5) == [0.03]
        assert rests_after(30, 0.9, 0.9, 0.9, 0.9) == [0.0, 0.0, 0.0, 0.002]
        assert rests_after(2, 0.4) == [0.002]
        assert rests_after(2, 0.1) == [0.03]
        pool.close()


@pytest.mark.parametrize(("rest_s", "shortest_s"), [(0.03, 0.01), (0.02, 0.02), (0.002, 0.002)])
def test_a_long_rest_ends_on_a_beat_and_never_late(rest_s: float, shortest_s: float) -> None:
    begun_ns = time.monotonic_ns()
    until_ns = round(pool_module.rested_s(rest_s) * NS_PER_S)
    ended_ns = time.monotonic_ns()
    assert until_ns <= ended_ns + rest_s * NS_PER_S
    assert until_ns >= begun_ns + shortest_s * NS_PER_S - 1000  # a float holds no single ns
    if rest_s > shortest_s:
        assert abs(until_ns - beat_before(until_ns + 1000)) <= 1000


@pytest.mark.parametrize(
    ("depth", "wanted_s", "rest_s"),
    [
        (10_000, 0.01, 0.01),
        (500, 0.01, 0.01),
        (450, 0.01, 0.009),
        (100, 0.01, 0.002),
        (1_500, 0.05, 0.03),
        (99, 0.01, 0.0),
        (10, 0.002, 0.0),
        (10_000, 0.0, 0.0),
    ],
)
def test_messages_collect_only_for_as_long_as_the_queue_holds(
    depth: int, wanted_s: float, rest_s: float
) -> None:
    assert affordable_rest_s(wanted_s, QoSProfile(depth=depth)) == rest_s
    assert affordable_rest_s(wanted_s, QoSProfile(history=HistoryPolicy.KEEP_ALL)) == wanted_s


async def test_a_poll_that_raises_leaves_the_pool_working(until: Until) -> None:
    told: list[Any] = []
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, report: told.append(report["exception"]))
    pool = Pool(loop, 0.001)
    fd = os.eventfd(1, os.EFD_NONBLOCK)

    class Failing:
        polls = 0

        def poll(self) -> bool:
            self.polls += 1
            if self.polls < 3:
                raise ValueError("no")
            os.eventfd_read(fd)
            return False

    source = Failing()
    pool.add(fd, source)
    await until(lambda: source.polls == 3)
    assert [str(error) for error in told] == ["no", "no"]
    pool.remove(fd)
    pool.close()
    os.close(fd)
