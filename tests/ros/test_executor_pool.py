"""Messages of taps and flooded subscriptions are collected; none is lost or too late.

A pool polls its sources, rests in between, and survives their exceptions.
Calls that were passed in before the loop runs come before later ones.
"""

from __future__ import annotations

import asyncio
import os
import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.qos import HistoryPolicy, QoSProfile
from std_msgs.msg import UInt64

from robotctl.ros import RawTap
from robotctl.ros.executor import runtime as pool_module
from robotctl.ros.executor.event_loop import NS_PER_S, beat_before
from robotctl.ros.executor.loop_thread import LoopThread
from robotctl.ros.executor.runtime import Pool
from robotctl.ros.executor.subscriptions import affordable_rest_s
from tests.ros.open_executor import Bench, Heard, comes_to_rest
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until


async def publish_from_a_thread(publisher: Any, count: int, pause_s: float) -> None:
    def run() -> None:
        for value in range(count):
            publisher.publish(UInt64(data=value))
            time.sleep(pause_s)

    thread = threading.Thread(target=run)
    thread.start()
    while thread.is_alive():  # noqa: ASYNC110 - a thread has no event
        await asyncio.sleep(0.01)


async def test_a_tap_takes_what_collected_in_one_look(bench: Bench) -> None:
    values = bench.tap()
    publisher = bench.publisher()
    await asyncio.sleep(0.01)
    source = bench.sources[values.entity]
    polls = 0
    poll = source.poll

    def counted() -> bool:
        nonlocal polls
        left: bool = poll()
        polls += not left  # the rest after a slice is polled in the next turn
        return left

    source.poll = counted
    begun = time.monotonic()
    await publish_from_a_thread(publisher, 200, 0.0005)
    await until(lambda: len(values) == 200)
    took_s = time.monotonic() - begun
    assert values == list(range(200))
    # A rest of about 10 ms after each look collects some 20; a look at each would be 200.
    assert polls <= 1.5 * took_s / 0.01 + 2


async def test_several_taps_share_one_wake_up(bench: Bench) -> None:
    turns: dict[int, set[int]] = {}
    turn = 0
    got = 0

    def tap(index: int) -> RawTap:
        def sink(*_: Any) -> None:
            nonlocal got
            got += 1
            turns.setdefault(turn, set()).add(index)

        return RawTap(sink)

    publishers = []
    for index in range(5):
        bench.listen(tap(index), f"{bench.topic}/n{index}", 1000, raw=True)
        publishers.append(bench.publisher(f"{bench.topic}/n{index}"))
    await asyncio.sleep(0.05)  # Attached, and the pool at rest or watching.
    for publisher in publishers:
        publisher.publish(UInt64())
    async with asyncio.timeout(DEADLINE_S):
        while got < 5:
            turn += 1
            await asyncio.sleep(0)
    assert list(turns.values()) == [{0, 1, 2, 3, 4}]


async def test_a_flooded_subscription_collects_until_it_is_calm_and_loses_nothing(
    bench: Bench,
) -> None:
    got = bench.hear(depth=10_000)
    bench.publisher(depth=10_000)
    await asyncio.sleep(0)
    source: Any = bench.sources[got.entity]
    sent = 0

    async def publish(pause_s: float) -> None:
        nonlocal sent
        bench.publish(sent)
        sent += 1
        await asyncio.sleep(pause_s)

    async with asyncio.timeout(DEADLINE_S):
        while source.pool is None:
            await publish(0)
        for _ in range(100):
            await publish(0)
        while source.pool is not None:
            await publish(0.003)
        for _ in range(10):
            await publish(0.003)
    await until(lambda: len(got) == sent)
    assert got == list(range(sent))


async def test_taps_may_be_destroyed_and_created_in_the_sink_of_another(bench: Bench) -> None:
    taps: list[Heard] = []

    def replace_all(*message: Any) -> None:
        # Descriptor numbers are freed and used again during a poll of the pool.
        for tap in taps:
            bench.destroy_subscription(tap.entity)
        taps[:] = [bench.tap() for _ in range(3)]

    replacing = bench.listen(RawTap(replace_all), depth=1000, raw=True)
    async with asyncio.timeout(DEADLINE_S):
        for value in range(20):
            bench.publish(value)
            await asyncio.sleep(0.015)
    bench.destroy_subscription(replacing)
    bench.publish(99)
    await until(lambda: [tap[-1:] for tap in taps] == [[99]] * 3)


async def test_a_tap_without_latency_is_called_when_it_is_polled_and_wakes_nobody(
    bench: Bench,
) -> None:
    values, heard = bench.tap(latency_s=None), bench.hear()
    await until(lambda: bench.publisher().get_subscription_count() == 2)
    bench.publish(7)
    await until(lambda: heard == [7])
    assert values == []

    def is_taken() -> bool:
        values.tap.poll()
        return values == [7]

    await until(is_taken)


async def test_a_tap_that_was_polled_in_the_same_turn_is_not_taken_twice(bench: Bench) -> None:
    values = bench.tap(latency_s=0.0)
    await until(bench.publisher().get_subscription_count)
    for value in range(20):
        bench.publish(value)
        values.tap.poll()
        await asyncio.sleep(0)
    await until(lambda: values == list(range(20)))


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


async def test_a_poll_that_raises_leaves_the_pool_working() -> None:
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


TURN_S = 0.1


class _Loop:
    """A loop that lets another thread pass in a call after the first of those that were kept."""

    def __init__(self, late: threading.Thread) -> None:
        self._late = late
        self.called: list[object] = []

    def call_soon(self, callback: object) -> None:
        self.called.append(callback)
        if self._late.ident is None:
            self._late.start()
            self._late.join(TURN_S)

    def call_soon_threadsafe(self, callback: object) -> None:
        self.called.append(callback)


async def test_a_tap_without_latency_is_looked_at_for_every_message(bench: Bench) -> None:
    got = bench.tap(latency_s=0.0)
    bench.publish(0)
    await until(lambda: got)
    assert bench.sources[got.entity].pool is None


async def test_taps_that_get_nothing_do_not_turn_the_loop(bench: Bench) -> None:
    taps = [bench.tap(f"{bench.topic}/n{index}") for index in range(5)]
    bench.publish(0, topic=f"{bench.topic}/n0")
    await until(lambda: taps[0])
    assert await comes_to_rest()


async def test_a_subscription_whose_queue_is_short_never_collects(bench: Bench) -> None:
    got = bench.hear()
    await asyncio.sleep(0)
    source: Any = bench.sources[got.entity]
    async with asyncio.timeout(DEADLINE_S):
        while len(got) < 500:
            bench.publish(len(got))
            await asyncio.sleep(0)
    assert source.pool is None


async def test_a_tap_destroyed_while_its_pool_rests_delivers_nothing_more(bench: Bench) -> None:
    got, other = bench.tap(), bench.tap()
    bench.publish(1)
    await until(lambda: got == other == [1])
    bench.publish(2)
    bench.destroy_subscription(got.entity)
    await until(lambda: other == [1, 2])
    assert got == [1]


def test_a_call_of_another_thread_while_the_loop_is_opened_comes_after_those_kept() -> None:
    calls = LoopThread()
    late = threading.Thread(target=calls.call_soon, args=(bool,))
    loop: Any = _Loop(late)
    calls.call_soon(int)
    calls.call_soon(str)
    calls.open(loop)
    late.join()
    assert loop.called == [int, str, bool]
