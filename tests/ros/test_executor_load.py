"""What an executor promises under load; the long tests are for the nightly run."""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import pytest
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap, Ticker
from tests.support.open_executor import sources_of
from tests.support.rclpy_types import Node

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Coroutine[Any, Any, Any]]


async def test_a_tap_sees_every_sequence_number_of_a_fast_publisher(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    sequences: list[int] = []
    tap = RawTap(lambda data, received_ns, source_ns, sequence, gid: sequences.append(sequence))
    subscription = node.create_subscription(UInt64, topic, tap, 10_000, raw=True)
    await peer("open", topic=topic)
    await until(subscription.get_publisher_count)
    sent = await peer("flood", topic=topic, hz=5000.0, seconds=1.0)
    await until(lambda: len(sequences) >= sent)
    assert sequences == list(range(1, sent + 1))


class Numbered:
    """Counts messages that carry numbers, and the numbers missing between them."""

    def __init__(self) -> None:
        self.count = 0
        self.lost = 0
        self.following = 0

    def add(self, number: int) -> None:
        assert number >= self.following, "a message came twice, or late"
        self.lost += number - self.following
        self.following = number + 1
        self.count += 1


async def flood_for(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until, seconds: float
) -> int:
    """Publish 10 kHz to a subscription and a tap, with a ticker and a service; return the losses.

    In any case the last message must arrive and every call must be answered.
    """
    typed, tapped = Numbered(), Numbered()
    subscription = node.create_subscription(UInt64, topic, lambda m: typed.add(m.data), 10_000)
    tap = RawTap(lambda data, received_ns, source_ns, sequence, gid: tapped.add(sequence - 1))
    node.create_subscription(UInt64, topic, tap, 10_000, raw=True)
    node.create_service(SetBool, topic, lambda request, response: response)
    client = node.create_client(SetBool, topic)
    await executor.wait_for_service(client, timeout_s=20.0)
    await peer("open", topic=topic)
    await until(subscription.get_publisher_count)
    flood = asyncio.create_task(peer("flood", topic=topic, hz=10_000.0, seconds=seconds))
    ticks = 0
    async with Ticker(100.0) as ticker:
        async for _ in ticker:
            ticks += 1
            if ticks % 10 == 0:
                await executor.call(client, SetBool.Request(), timeout_s=20.0)
            if flood.done():
                break
    sent = await flood
    await until(lambda: typed.following == tapped.following == sent)
    assert typed.count + typed.lost == tapped.count + tapped.lost == sent
    return max(typed.lost, tapped.lost)


@pytest.mark.slow
async def test_10_khz_for_10_s_loses_nothing(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    assert await flood_for(executor, node, peer, topic, until, 10.0) == 0


@pytest.mark.slow
async def test_10_khz_for_10_minutes_never_hangs(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    before = len(os.listdir("/proc/self/fd")), threading.active_count()
    # On a machine that starves the process for seconds the middleware may drop some.
    await flood_for(executor, node, peer, topic, until, 600.0)
    after = len(os.listdir("/proc/self/fd")), threading.active_count()
    # The entities of the test: nine descriptors with their events, and no thread.
    assert after[0] - before[0] <= 12
    assert after[1] - before[1] <= 1


@pytest.mark.slow
async def test_churn_of_subscriptions_under_a_foreign_flood(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    got: list[int] = []
    await peer("flood_in_background", topic=topic, hz=2000.0)
    try:
        for _ in range(300):
            batch = [
                node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 10),
                node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 10, raw=True),
            ]
            await asyncio.sleep(0.01)
            for subscription in batch:
                node.destroy_subscription(subscription)
    finally:
        await peer("calm", topic=topic)
    await until(lambda: not [s for s in sources_of(executor).values() if topic in s.where])
    assert got
