"""Subscriptions and publishers under AsyncioExecutor, against a process with plain rclpy."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from rclpy.serialization import deserialize_message
from std_msgs.msg import UInt64

from robotctl.ros import AsyncioExecutor, RawTap
from robotctl.ros.executor import announcements
from tests.support.rclpy_types import Node

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Awaitable[Any]]
Feed = Callable[[Any, list[int]], Awaitable[None]]


async def test_a_typed_subscription_delivers_every_message_in_order(
    executor: AsyncioExecutor, node: Node, feed: Feed, topic: str, until: Until
) -> None:
    got: list[int] = []
    subscription = node.create_subscription(
        UInt64, topic, lambda message: got.append(message.data), 1000
    )
    await feed(subscription, list(range(500)))
    await until(lambda: len(got) >= 500)
    assert got == list(range(500))


async def test_a_callback_of_two_arguments_gets_the_message_info(
    executor: AsyncioExecutor, node: Node, feed: Feed, topic: str, until: Until
) -> None:
    got: list[tuple[int, dict[str, int]]] = []
    subscription = node.create_subscription(
        UInt64, topic, lambda message, info: got.append((message, info)), 10
    )
    await feed(subscription, [5, 6])
    await until(lambda: len(got) == 2)
    assert [info["publication_sequence_number"] for _, info in got] == [1, 2]
    assert 0 < got[0][1]["source_timestamp"] <= got[0][1]["received_timestamp"]


async def test_a_raw_subscription_gets_the_serialized_bytes(
    executor: AsyncioExecutor, node: Node, feed: Feed, topic: str, until: Until
) -> None:
    got: list[bytes] = []
    subscription = node.create_subscription(UInt64, topic, got.append, 10, raw=True)
    await feed(subscription, [7])
    await until(lambda: got)
    assert deserialize_message(got[0], UInt64).data == 7


async def test_a_tap_tells_two_publishers_apart_and_numbers_the_messages_of_each(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    got: list[tuple[bytes, int, int, int, bytes]] = []
    tap = RawTap(lambda *item: got.append(item))
    subscription = node.create_subscription(UInt64, topic, tap, 100, raw=True)
    own = node.create_publisher(UInt64, topic, 10)
    for value in (100, 101, 102):
        own.publish(UInt64(data=value))
    await peer("open", topic=topic)
    await until(lambda: subscription.get_publisher_count() == 2)
    await peer("publish", topic=topic, values=[0, 1, 2])
    await until(lambda: len(got) == 6)
    by_publisher: dict[bytes, list[tuple[int, int]]] = {}
    for data, received_ns, source_ns, sequence, gid in got:
        assert 0 < source_ns <= received_ns
        assert len(gid) == 16
        value = deserialize_message(data, UInt64).data
        by_publisher.setdefault(gid, []).append((sequence, value))
    assert sorted(by_publisher.values()) == [
        [(1, 0), (2, 1), (3, 2)],
        [(1, 100), (2, 101), (3, 102)],
    ]
    infos = node.get_publishers_info_by_topic(topic)
    assert set(by_publisher) == {bytes(info.endpoint_gid[:16]) for info in infos}


async def test_a_tap_takes_messages_of_growing_and_shrinking_size(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    from std_msgs.msg import String

    got: list[bytes] = []
    node.create_subscription(
        String, topic, RawTap(lambda data, *_: got.append(data)), 100, raw=True
    )
    publisher = node.create_publisher(String, topic, 100)
    sizes = [1, 5000, 3, 200_000, 0, 200_001]
    for size in sizes:
        publisher.publish(String(data="x" * size))
    await until(lambda: len(got) == len(sizes))
    assert [len(deserialize_message(data, String).data) for data in got] == sizes


async def test_an_async_subscription_callback_may_await_asyncio(
    executor: AsyncioExecutor, node: Node, feed: Feed, topic: str, until: Until
) -> None:
    got: list[int] = []

    async def callback(message: UInt64) -> None:
        await asyncio.sleep(0.001)
        got.append(message.data)

    subscription = node.create_subscription(UInt64, topic, callback, 100)
    await feed(subscription, list(range(20)))
    await until(lambda: len(got) == 20)
    assert got == list(range(20))


@pytest.mark.parametrize("announced", [True, False])
async def test_messages_from_before_the_node_was_added_are_delivered(
    context: Any,
    node: Node,
    feed: Feed,
    topic: str,
    until: Until,
    monkeypatch: pytest.MonkeyPatch,
    announced: bool,
) -> None:
    if not announced:  # another middleware may announce later messages only
        monkeypatch.setattr(announcements, "watch", lambda *_: None)
        monkeypatch.setattr(announcements, "unwatch", lambda *_: None)
    got: list[int] = []
    subscription = node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 100)
    await feed(subscription, [1, 2, 3])
    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        await until(lambda: got == [1, 2, 3])


async def test_what_we_publish_reaches_the_other_process(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    await peer("listen", topic=topic)
    publisher = node.create_publisher(UInt64, topic, 100)
    await until(publisher.get_subscription_count)
    for value in range(10):
        publisher.publish(UInt64(data=value))
    assert await peer("heard", topic=topic, count=10) == list(range(10))
