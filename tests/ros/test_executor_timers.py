"""Timers under AsyncioExecutor, on the steady clock and on ROS time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from robotctl.ros import AsyncioExecutor
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Awaitable[Any]]


async def test_a_steady_timer_fires_and_a_cancelled_one_does_not_until_its_reset(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    fired: list[int] = []
    steady = Clock(clock_type=ClockType.STEADY_TIME)
    timer = node.create_timer(0.01, lambda: fired.append(1), clock=steady)
    reference: list[int] = []
    node.create_timer(0.01, lambda: reference.append(1), clock=steady)
    await until(lambda: len(fired) >= 3)

    timer.cancel()
    count, passed = len(fired), len(reference)
    await until(lambda: len(reference) >= passed + 5)
    assert len(fired) == count

    timer.reset()
    await until(lambda: len(fired) >= count + 3)


async def test_a_timer_created_stopped_starts_with_its_reset(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    fired: list[int] = []
    reference: list[int] = []
    timer = node.create_timer(0.01, lambda: fired.append(1), autostart=False)
    node.create_timer(0.01, lambda: reference.append(1))
    await until(lambda: len(reference) >= 5)
    assert fired == []
    timer.reset()
    await until(lambda: len(fired) >= 2)


async def test_a_timer_may_cancel_itself_and_take_an_async_callback(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    fired: list[int] = []

    async def callback() -> None:
        timer.cancel()
        await asyncio.sleep(0.001)
        fired.append(1)

    timer = node.create_timer(0.005, callback)
    reference: list[int] = []
    node.create_timer(0.005, lambda: reference.append(1))
    await until(lambda: fired and len(reference) >= 6)
    assert fired == [1]


async def test_a_ros_time_timer_follows_clock_and_nothing_else(
    executor: AsyncioExecutor, node: Node, peer: Peer, until: Until
) -> None:
    node.set_parameters([Parameter("use_sim_time", value=True)])
    fired: list[int] = []
    steady: list[int] = []

    async def tell(nanoseconds: int) -> None:
        # Best effort: the first messages may be sent before the two have matched.
        async with asyncio.timeout(DEADLINE_S):
            while node.get_clock().now().nanoseconds != nanoseconds:
                await peer("tell_time", nanoseconds=nanoseconds)
                await asyncio.sleep(0.02)

    second = 10**9
    await tell(100 * second)
    node.create_timer(1.0, lambda: fired.append(node.get_clock().now().nanoseconds))
    node.create_timer(0.01, lambda: steady.append(1), clock=Clock(clock_type=ClockType.STEADY_TIME))
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


async def test_a_ros_time_timer_runs_again_when_sim_time_ends(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    node.set_parameters([Parameter("use_sim_time", value=True)])
    fired: list[int] = []
    node.create_timer(0.01, lambda: fired.append(1))
    steady: list[int] = []
    node.create_timer(0.01, lambda: steady.append(1), clock=Clock(clock_type=ClockType.STEADY_TIME))
    await until(lambda: len(steady) >= 5)
    assert fired == []
    node.set_parameters([Parameter("use_sim_time", value=False)])
    await until(lambda: len(fired) >= 2)
