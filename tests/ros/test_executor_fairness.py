"""No entity holds the loop longer than its slice, whatever its backlog."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap, Ticker
from robotctl.ros.executor.event_loop import SHORTEST_SLICE_NS, SLICE_NS, TURN_NS
from tests.support.open_executor import runtime_of
from tests.support.rclpy_types import Node
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]


@pytest.mark.parametrize("raw", [False, True])
async def test_a_flooded_subscription_ends_its_slice_and_goes_on_in_the_next(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until, raw: bool
) -> None:
    turns: list[int] = []
    turn = 0

    def work(*_: Any) -> None:
        time.sleep(0.0001)
        turns.append(turn)

    if raw:
        node.create_subscription(UInt64, topic, RawTap(work), 1000, raw=True)
    else:
        node.create_subscription(UInt64, topic, work, 1000)
    publisher = node.create_publisher(UInt64, topic, 1000)
    await asyncio.sleep(0.01)
    for value in range(200):
        publisher.publish(UInt64(data=value))

    async def count_turns() -> None:
        nonlocal turn
        while len(turns) < 200:
            turn += 1
            await asyncio.sleep(0)

    async with asyncio.timeout(DEADLINE_S):
        await count_turns()
    # 0.1 ms each in slices of 0.3 ms: a few a turn, never a long run.
    per_turn = [turns.count(number) for number in set(turns)]
    assert max(per_turn) <= 1 + SLICE_NS // 100_000
    assert len(per_turn) >= 200 // (1 + SLICE_NS // 100_000)


async def test_a_flood_delays_neither_a_service_nor_the_tick_by_its_backlog(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []

    def work(message: UInt64) -> None:
        time.sleep(0.0005)
        got.append(message.data)

    node.create_subscription(UInt64, topic, work, 2000)
    node.create_service(SetBool, topic, lambda request, response: response)
    client = node.create_client(SetBool, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    publisher = node.create_publisher(UInt64, topic, 2000)
    backlog = 1000
    for value in range(backlog):
        publisher.publish(UInt64(data=value))
    # Half a second of work waits. Later entities are served before it is done.
    async with asyncio.timeout(DEADLINE_S), Ticker(1000.0) as ticker:
        for _ in range(2):
            await executor.call(client, SetBool.Request(), timeout_s=DEADLINE_S)
            await anext(ticker)
    assert 0 < len(got) < backlog
    await until(lambda: len(got) == backlog)


async def test_many_flooded_entities_share_one_turn(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    runtime = runtime_of(executor)
    floods = 10
    got = [0] * floods
    slices: set[int] = set()

    def worker(index: int) -> Callable[[UInt64], None]:
        def work(message: UInt64) -> None:
            time.sleep(0.0001)
            slices.add(runtime.slice_ns)
            got[index] += 1

        return work

    publishers = []
    for index in range(floods):
        node.create_subscription(UInt64, f"{topic}/n{index}", worker(index), 100)
        publishers.append(node.create_publisher(UInt64, f"{topic}/n{index}", 100))
    await asyncio.sleep(0.01)
    for publisher in publishers:
        for value in range(50):
            publisher.publish(UInt64(data=value))
    await until(lambda: got == [50] * floods)
    assert min(slices) == max(TURN_NS // floods, SHORTEST_SLICE_NS)
    await until(lambda: runtime.slice_ns == SLICE_NS)
