"""Timers under AsyncioExecutor, on the steady clock and on ROS time.

The ticker keeps its schedule, counts missed ticks, and frees its timer.
"""

from __future__ import annotations

import asyncio
import time
from itertools import pairwise

import pytest
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter

from robotctl.ros import Tick, Ticker
from tests.ros.conftest import Peer
from tests.ros.open_executor import Bench, loop_descriptors, turns_while_waiting
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until

STEADY = Clock(clock_type=ClockType.STEADY_TIME)


async def test_a_steady_timer_fires_and_a_cancelled_one_does_not_until_its_reset(
    bench: Bench,
) -> None:
    fired, reference = bench.ticks(clock=STEADY), bench.ticks(clock=STEADY)
    await until(lambda: len(fired) >= 3)

    fired.entity.cancel()
    count, passed = len(fired), len(reference)
    await until(lambda: len(reference) >= passed + 5)
    assert len(fired) == count

    fired.entity.reset()
    await until(lambda: len(fired) >= count + 3)


async def test_a_timer_created_stopped_starts_with_its_reset(bench: Bench) -> None:
    fired, reference = bench.ticks(autostart=False), bench.ticks()
    await until(lambda: len(reference) >= 5)
    assert fired == []
    fired.entity.reset()
    await until(lambda: len(fired) >= 2)


async def test_a_timer_may_cancel_itself_and_take_an_async_callback(bench: Bench) -> None:
    fired: list[int] = []

    async def callback() -> None:
        timer.cancel()
        await asyncio.sleep(0.001)
        fired.append(1)

    timer = bench.create_timer(0.005, callback)
    reference = bench.ticks(0.005)
    await until(lambda: fired and len(reference) >= 6)
    assert fired == [1]


async def test_a_ros_time_timer_follows_clock_and_nothing_else(bench: Bench, peer: Peer) -> None:
    bench.set_parameters([Parameter("use_sim_time", value=True)])
    fired: list[int] = []

    async def tell(nanoseconds: int) -> None:
        # Best effort: the first messages may be sent before the two have matched.
        async with asyncio.timeout(DEADLINE_S):
            while bench.get_clock().now().nanoseconds != nanoseconds:
                await peer("tell_time", nanoseconds=nanoseconds)
                await asyncio.sleep(0.02)

    second = 10**9
    await tell(100 * second)
    bench.create_timer(1.0, lambda: fired.append(bench.get_clock().now().nanoseconds))
    steady = bench.ticks(clock=STEADY)
    await until(lambda: len(steady) >= 10)
    assert fired == []

    await tell(100 * second + second // 2)
    passed = len(steady)
    await until(lambda: len(steady) >= passed + 10)
    assert fired == []

    await tell(101 * second)
    await until(lambda: fired == [101 * second])
    # Ten periods at once: as in rcl, one call, then the schedule continues.
    await tell(111 * second)
    await until(lambda: fired == [101 * second, 111 * second])
    await tell(112 * second)
    await until(lambda: fired == [101 * second, 111 * second, 112 * second])


async def test_a_ros_time_timer_runs_again_when_sim_time_ends(bench: Bench) -> None:
    bench.set_parameters([Parameter("use_sim_time", value=True)])
    fired = bench.ticks()
    steady = bench.ticks(clock=STEADY)
    await until(lambda: len(steady) >= 5)
    assert fired == []
    bench.set_parameters([Parameter("use_sim_time", value=False)])
    await until(lambda: len(fired) >= 2)


async def test_every_tick_is_due_at_a_multiple_of_the_period_after_the_first() -> None:
    async with asyncio.timeout(DEADLINE_S), Ticker(200.0) as ticker:
        ticks = [await anext(ticker) for _ in range(20)]
    for before, after in pairwise(ticks):
        assert after.due_ns - before.due_ns == (after.missed + 1) * 5_000_000
        assert after.t_ns >= after.due_ns
    assert ticks[0].t_ns <= time.monotonic_ns()


async def test_ticks_missed_while_the_loop_was_busy_are_counted_and_not_repeated() -> None:
    async with asyncio.timeout(DEADLINE_S), Ticker(200.0) as ticker:
        before = await anext(ticker)
        time.sleep(0.0525)  # noqa: ASYNC251 - the loop is to be busy
        late = await anext(ticker)
        after = await anext(ticker)
    assert late.missed >= 9
    assert late.due_ns - before.due_ns == (late.missed + 1) * 5_000_000
    assert after.due_ns > late.t_ns - 5_000_000


async def test_a_consumer_that_is_always_late_leaves_the_loop_its_turns() -> None:
    turns = 0

    async def other() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async with asyncio.timeout(DEADLINE_S), Ticker(1000.0) as ticker:
        task = asyncio.create_task(other())
        for _ in range(20):
            await anext(ticker)
            time.sleep(0.003)  # noqa: ASYNC251 - the consumer is to be late
        task.cancel()
    assert turns >= 20


async def test_a_ticker_that_nobody_awaits_does_not_turn_the_loop() -> None:
    async with asyncio.timeout(DEADLINE_S), Ticker(100.0) as ticker:
        await anext(ticker)
        # 10 expiries, the sleep itself, and room for a few strays.
        assert await turns_while_waiting() < 100
        assert (await anext(ticker)).missed >= 5


async def test_leaving_the_loop_lets_the_descriptor_go() -> None:
    before = loop_descriptors()
    async with asyncio.timeout(DEADLINE_S):
        async for _ in Ticker(500.0):
            assert loop_descriptors() == before + 1
            break
    assert loop_descriptors() == before


async def test_close_ends_a_waiting_iteration() -> None:
    before = loop_descriptors()
    ticker = Ticker(0.01)
    ticks = []

    async def consume() -> None:
        ticks.extend([tick async for tick in ticker])

    task = asyncio.create_task(consume())
    await asyncio.sleep(0)
    assert loop_descriptors() == before + 1
    ticker.close()
    ticker.close()
    async with asyncio.timeout(DEADLINE_S):
        await task
    assert ticks == []
    assert loop_descriptors() == before
    with pytest.raises(StopAsyncIteration):
        await anext(ticker)


async def test_a_cancelled_wait_leaves_the_ticker_usable() -> None:
    async with asyncio.timeout(DEADLINE_S), Ticker(50.0) as ticker:
        task = asyncio.ensure_future(anext(ticker))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        ticks = [await anext(ticker) for _ in range(2)]
    assert ticks[1].due_ns - ticks[0].due_ns == (ticks[1].missed + 1) * 20_000_000


async def test_a_second_task_at_the_same_ticker_is_refused() -> None:
    async with Ticker(1.0) as ticker:
        first = asyncio.ensure_future(anext(ticker))
        await asyncio.sleep(0)
        with pytest.raises(RuntimeError, match="another task waits"):
            await anext(ticker)
        first.cancel()


@pytest.mark.parametrize("hz", [0.0, -1.0, float("nan"), float("inf"), 10_001.0])
def test_a_rate_that_cannot_be_kept_is_refused(hz: float) -> None:
    with pytest.raises(ValueError, match="Hz"):
        Ticker(hz)


async def test_a_function_is_called_for_each_tick_until_the_ticker_is_closed() -> None:
    ticks: list[Tick] = []
    ticker = Ticker(200.0)

    def take(tick: Tick) -> None:
        ticks.append(tick)
        if len(ticks) == 5:
            ticker.close()

    async with asyncio.timeout(DEADLINE_S):
        await ticker.run(take)
    assert len(ticks) == 5
    for before, after in pairwise(ticks):
        assert after.due_ns - before.due_ns == (after.missed + 1) * 5_000_000


async def test_what_the_function_raises_ends_the_run_and_its_ticks() -> None:
    calls = 0

    def fail(tick: Tick) -> None:
        nonlocal calls
        calls += 1
        raise ValueError("no step")

    async with asyncio.timeout(DEADLINE_S), Ticker(1000.0) as ticker:
        with pytest.raises(ValueError, match="no step"):
            await ticker.run(fail)
        await anext(ticker)
    assert calls == 1


async def test_tickers_of_one_rate_tick_together_and_one_with_a_lead_before_them() -> None:
    async with asyncio.timeout(DEADLINE_S), Ticker(100.0) as one, Ticker(100.0) as other:
        first = await anext(one)
        second = await anext(other)
        async with Ticker(100.0, lead_ns=100_000) as early:
            third = await anext(early)
    assert (second.due_ns - first.due_ns) % one.period_ns == 0
    assert (first.due_ns - third.due_ns) % one.period_ns == 100_000


async def test_a_second_loop_is_refused() -> None:
    async with Ticker(1.0) as ticker:

        def elsewhere() -> None:
            async def use() -> None:
                await anext(ticker)

            with pytest.raises(RuntimeError, match="another event loop"):
                asyncio.run(use())

        await asyncio.to_thread(elsewhere)


async def test_a_cancelled_run_calls_its_function_no_more() -> None:
    ticks: list[Tick] = []
    async with asyncio.timeout(DEADLINE_S), Ticker(1000.0) as ticker:
        task = asyncio.ensure_future(ticker.run(ticks.append))
        while not ticks:  # noqa: ASYNC110 - a ticker has no event
            await asyncio.sleep(0)
        task.cancel()
        count = len(ticks)
        await asyncio.wait({task})
        await anext(ticker)
    assert len(ticks) == count
