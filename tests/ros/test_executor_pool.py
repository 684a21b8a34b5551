"""Messages of taps and flooded subscriptions are collected; none is lost or too late."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt64

from robotctl.ros import AsyncioExecutor, RawTap
from tests.support.open_executor import sources_of
from tests.support.rclpy_types import Node
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]


def value_of(data: bytes) -> int:
    value: int = deserialize_message(data, UInt64).data
    return value


async def publish_from_a_thread(publisher: Any, count: int, pause_s: float) -> None:
    def run() -> None:
        for value in range(count):
            publisher.publish(UInt64(data=value))
            time.sleep(pause_s)

    thread = threading.Thread(target=run)
    thread.start()
    while thread.is_alive():  # noqa: ASYNC110 - a thread has no event
        await asyncio.sleep(0.01)


async def test_a_tap_takes_what_collected_in_one_look(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    values: list[int] = []
    node.create_subscription(
        UInt64, topic, RawTap(lambda data, *_: values.append(value_of(data))), 1000, raw=True
    )
    publisher = node.create_publisher(UInt64, topic, 1000)
    await asyncio.sleep(0.01)
    (source,) = (s for s in sources_of(executor).values() if "tap" in s.where)
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
    # A rest of 10 ms after each look collects some 20 of them; a look at each would be 200.
    assert polls <= took_s / 0.01 + 2


async def test_several_taps_share_one_wake_up(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
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
        node.create_subscription(UInt64, f"{topic}/n{index}", tap(index), 1000, raw=True)
        publishers.append(node.create_publisher(UInt64, f"{topic}/n{index}", 1000))
    await asyncio.sleep(0.05)  # Attached, and the pool at rest or watching.
    for publisher in publishers:
        publisher.publish(UInt64())
    async with asyncio.timeout(DEADLINE_S):
        while got < 5:
            turn += 1
            await asyncio.sleep(0)
    assert list(turns.values()) == [{0, 1, 2, 3, 4}]


async def test_a_tap_without_latency_is_looked_at_for_every_message(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[bytes] = []
    tap = RawTap(lambda data, *_: got.append(data), latency_s=0.0)
    subscription = node.create_subscription(UInt64, topic, tap, 1000, raw=True)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: got)
    assert sources_of(executor)[subscription].pool is None


async def test_taps_that_get_nothing_do_not_turn_the_loop(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    comes_to_rest: Callable[[], Awaitable[bool]],
) -> None:
    got: list[bytes] = []
    for index in range(5):
        tap = RawTap(lambda data, *_: got.append(data))
        node.create_subscription(UInt64, f"{topic}/n{index}", tap, 1000, raw=True)
    node.create_publisher(UInt64, f"{topic}/n0", 10).publish(UInt64())
    await until(lambda: got)
    assert await comes_to_rest()


async def test_a_flooded_subscription_collects_until_it_is_calm_and_loses_nothing(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    subscription = node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 10_000)
    publisher = node.create_publisher(UInt64, topic, 10_000)
    await asyncio.sleep(0)
    source: Any = sources_of(executor)[subscription]
    sent = 0

    async def publish(pause_s: float) -> None:
        nonlocal sent
        publisher.publish(UInt64(data=sent))
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


async def test_a_subscription_whose_queue_is_short_never_collects(
    executor: AsyncioExecutor, node: Node, topic: str
) -> None:
    got: list[int] = []
    subscription = node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    await asyncio.sleep(0)
    source: Any = sources_of(executor)[subscription]
    async with asyncio.timeout(DEADLINE_S):
        while len(got) < 500:
            publisher.publish(UInt64(data=len(got)))
            await asyncio.sleep(0)
    assert source.pool is None


async def test_taps_may_be_destroyed_and_created_in_the_sink_of_another(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    subscriptions: list[Any] = []

    def replace_all(*message: Any) -> None:
        # Descriptor numbers are freed and used again during a poll of the pool.
        for subscription in subscriptions[1:]:
            node.destroy_subscription(subscription)
        del subscriptions[1:]
        for _ in range(3):
            tap = RawTap(lambda data, *_: got.append(value_of(data)))
            subscriptions.append(node.create_subscription(UInt64, topic, tap, 1000, raw=True))

    subscriptions.append(
        node.create_subscription(UInt64, topic, RawTap(replace_all), 1000, raw=True)
    )
    publisher = node.create_publisher(UInt64, topic, 1000)
    async with asyncio.timeout(DEADLINE_S):
        for value in range(20):
            publisher.publish(UInt64(data=value))
            await asyncio.sleep(0.015)
    node.destroy_subscription(subscriptions.pop(0))
    publisher.publish(UInt64(data=99))
    await until(lambda: got.count(99) == 3)


async def test_a_tap_destroyed_while_its_pool_rests_delivers_nothing_more(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    other: list[int] = []
    doomed = node.create_subscription(
        UInt64, topic, RawTap(lambda data, *_: got.append(value_of(data))), 1000, raw=True
    )
    node.create_subscription(
        UInt64, topic, RawTap(lambda data, *_: other.append(value_of(data))), 1000, raw=True
    )
    publisher = node.create_publisher(UInt64, topic, 1000)
    publisher.publish(UInt64(data=1))
    await until(lambda: got == other == [1])
    publisher.publish(UInt64(data=2))
    node.destroy_subscription(doomed)
    await until(lambda: other == [1, 2])
    assert got == [1]


async def test_a_tap_without_latency_is_called_when_it_is_polled_and_wakes_nobody(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    values: list[int] = []
    tap = RawTap(lambda data, *_: values.append(value_of(data)), latency_s=None)
    node.create_subscription(UInt64, topic, tap, 10, raw=True)
    heard: list[int] = []
    node.create_subscription(UInt64, topic, lambda message: heard.append(message.data), 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    await until(lambda: publisher.get_subscription_count() == 2)
    publisher.publish(UInt64(data=7))
    await until(lambda: heard == [7])
    assert values == []

    def is_taken() -> bool:
        tap.poll()
        return values == [7]

    await until(is_taken)


async def test_a_tap_that_was_polled_in_the_same_turn_is_not_taken_twice(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    values: list[int] = []
    tap = RawTap(lambda data, *_: values.append(value_of(data)), latency_s=0.0)
    node.create_subscription(UInt64, topic, tap, 10, raw=True)
    publisher = node.create_publisher(UInt64, topic, 10)
    await until(publisher.get_subscription_count)
    for value in range(20):
        publisher.publish(UInt64(data=value))
        tap.poll()
        await asyncio.sleep(0)
    await until(lambda: values == list(range(20)))
