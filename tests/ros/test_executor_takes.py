"""How often AsyncioExecutor takes from a subscription, and that no message is left behind."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest
from std_msgs.msg import String, UInt64

from robotctl.ros import AsyncioExecutor
from robotctl.ros.executor.raw_tap import LARGE_BYTES, SerializedTaker
from robotctl.ros.executor.sources import subscriptions
from tests.support.rclpy_types import Node

Until = Callable[[Callable[[], object]], Awaitable[None]]


@pytest.fixture
def takes(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Whether each take so far found a message."""
    found: list[bool] = []
    take = SerializedTaker.take

    def counted(taker: SerializedTaker) -> object:
        item = take(taker)
        found.append(item is not None)
        return item

    monkeypatch.setattr(SerializedTaker, "take", counted)
    return found


async def test_a_message_is_taken_once_and_nothing_else(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until, takes: list[bool]
) -> None:
    got: list[int] = []
    node.create_subscription(UInt64, topic, lambda message: got.append(message.data), 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    await until(lambda: takes == [False])  # what was there before the executor
    for value in range(5):
        publisher.publish(UInt64(data=value))
        await until(lambda: len(got) > value)  # noqa: B023
    assert takes == [False, *[True] * 5]


async def test_a_middleware_that_does_not_count_messages_is_asked_until_none_is_left(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    takes: list[bool],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(subscriptions, "counts_each_message", lambda: False)
    got: list[int] = []
    node.create_subscription(UInt64, topic, lambda message: got.append(message.data), 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    await until(lambda: takes == [False])
    publisher.publish(UInt64(data=1))
    await until(lambda: got)
    assert takes == [False, True, False]


async def test_the_memory_of_a_large_message_is_looked_after_at_once(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until, takes: list[bool]
) -> None:
    got: list[str] = []
    node.create_subscription(String, topic, lambda message: got.append(message.data), 10)
    publisher = node.create_publisher(String, topic, 10)
    await until(lambda: takes == [False])
    publisher.publish(String(data="x" * LARGE_BYTES))
    await until(lambda: got)
    assert takes == [False, True, False]


async def test_messages_that_waited_for_their_callback_group_are_all_delivered(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until, takes: list[bool]
) -> None:
    got: list[int] = []
    busy, free = asyncio.Event(), asyncio.Event()

    async def occupy(_: UInt64) -> None:
        busy.set()
        await free.wait()

    node.create_subscription(UInt64, f"{topic}_first", occupy, 10)
    node.create_subscription(UInt64, topic, lambda message: got.append(message.data), 10)
    first = node.create_publisher(UInt64, f"{topic}_first", 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    await until(lambda: takes == [False, False])
    first.publish(UInt64())
    await busy.wait()
    for value in range(5):
        publisher.publish(UInt64(data=value))
    engine = executor._engine
    await until(lambda: engine is not None and engine.runtime._parked)
    free.set()
    await until(lambda: len(got) == 5)
    assert got == list(range(5))


async def test_messages_beyond_a_slice_of_the_loop_are_delivered_in_the_next_ones(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until, takes: list[bool]
) -> None:
    assert executor._engine is not None
    executor._engine.runtime.slice_ns = -1
    got: list[int] = []
    node.create_subscription(UInt64, topic, lambda message: got.append(message.data), 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    await until(lambda: takes == [False])
    for value in range(6):
        publisher.publish(UInt64(data=value))
    await until(lambda: len(got) == 6)
    assert got == list(range(6))
