"""QoS events under AsyncioExecutor, against a process with plain rclpy."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt64

from robotctl.ros import AsyncioExecutor
from tests.support.open_executor import sources_of
from tests.support.rclpy_types import Node
from tests.support.waiting import until as wait_until

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Awaitable[Any]]
Feed = Callable[[Any, list[int]], Awaitable[None]]


def reliable(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


async def meet_incompatible(
    node: Node, peer: Peer, topic: str, callback: Callable[[Any], None]
) -> None:
    """Subscribe reliably to a topic that the peer then offers as best effort."""
    callbacks = SubscriptionEventCallbacks(incompatible_qos=callback)
    node.create_subscription(UInt64, topic, lambda _: None, reliable(10), event_callbacks=callbacks)
    await peer("offer", topic=topic, reliable=False)


async def test_matched_events_come_when_the_other_side_appears_and_goes(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[tuple[int, int]] = []

    def tell(event: Any) -> None:
        seen.append((event.current_count, event.current_count_change))

    callbacks = SubscriptionEventCallbacks(matched=tell)
    node.create_subscription(UInt64, topic, lambda _: None, 10, event_callbacks=callbacks)
    await peer("offer", topic=topic)
    await until(lambda: seen == [(1, 1)])
    await peer("withdraw", topic=topic)
    await until(lambda: seen == [(1, 1), (0, -1)])


async def test_a_match_from_before_the_node_was_added_is_told_once(
    context: Any, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[int] = []

    def tell(event: Any) -> None:
        seen.append(event.current_count)

    await peer("listen", topic=topic)
    callbacks = PublisherEventCallbacks(matched=tell)
    publisher = node.create_publisher(UInt64, topic, 10, event_callbacks=callbacks)
    await until(publisher.get_subscription_count)
    reference: list[int] = []
    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        node.create_timer(0.01, lambda: reference.append(1))
        await until(lambda: seen and len(reference) >= 5)
    assert seen == [1]


async def test_incompatible_qos_is_told(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[int] = []
    await meet_incompatible(node, peer, topic, lambda event: seen.append(event.total_count_change))
    await until(lambda: seen == [1])


async def test_an_incompatible_offer_from_before_the_node_was_added_counts_as_one(
    context: Any, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[Any] = []
    await meet_incompatible(node, peer, topic, seen.append)
    await until(lambda: node.count_publishers(topic))
    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        await until(lambda: seen)
    event = seen[0]
    assert (event.total_count, event.total_count_change) == (1, 1)
    assert event.last_policy_kind == QoSPolicyKind.RELIABILITY


async def test_what_an_executor_of_rclpy_has_told_is_not_told_again(
    context: Any, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[tuple[int, int, int]] = []

    def tell(event: Any) -> None:
        seen.append((event.total_count, event.total_count_change, event.current_count_change))

    callbacks = PublisherEventCallbacks(matched=tell)
    node.create_publisher(UInt64, topic, 10, event_callbacks=callbacks)
    await peer("listen", topic=topic)
    theirs = SingleThreadedExecutor(context=context)
    theirs.add_node(node)

    def tells() -> bool:
        theirs.spin_once(timeout_sec=0.01)
        return bool(seen)

    await asyncio.to_thread(wait_until, tells)
    theirs.remove_node(node)
    theirs.shutdown()
    assert seen == [(1, 1, 1)]
    local = node.create_subscription(UInt64, topic, lambda _: None, 10)
    turns: list[int] = []
    node.create_timer(0.01, lambda: turns.append(1))
    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        await until(lambda: len(seen) >= 2)
    turns.clear()
    async with AsyncioExecutor(context) as executor:  # Nor by a publisher of this process.
        executor.add_node(node)
        await until(lambda: len(turns) >= 5)
    assert seen == [(1, 1, 1), (2, 1, 1)]
    node.destroy_subscription(local)


async def test_an_event_announced_after_it_was_taken_is_not_told_again(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[int] = []

    def tell(event: Any) -> None:
        seen.append(event.total_count_change)

    await meet_incompatible(node, peer, topic, tell)
    await until(lambda: seen == [1])
    (announced,) = (
        source for source in sources_of(executor).values() if source.entity.callback is tell
    )
    announced.resume()
    reference: list[int] = []
    node.create_timer(0.01, lambda: reference.append(1))
    await until(lambda: len(reference) >= 5)
    assert seen == [1]


async def test_a_missed_deadline_is_told(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[int] = []
    qos = QoSProfile(depth=10, deadline=Duration(nanoseconds=50_000_000))

    def tell(event: Any) -> None:
        seen.append(event.total_count_change)

    callbacks = SubscriptionEventCallbacks(deadline=tell)
    node.create_subscription(UInt64, topic, lambda _: None, qos, event_callbacks=callbacks)
    await peer("offer", topic=topic, deadline_s=0.05)
    await peer("publish", topic=topic, values=[1])
    await until(lambda: sum(seen) >= 2)


async def test_message_lost_events_are_watched_without_inventing_any(
    executor: AsyncioExecutor, node: Node, feed: Feed, topic: str, until: Until
) -> None:
    # This middleware never sends the event (sequence gaps show losses instead). The test shows only
    # that it is attached and that no event is invented.
    seen: list[object] = []
    got: list[int] = []
    callbacks = SubscriptionEventCallbacks(message_lost=seen.append)
    subscription = node.create_subscription(
        UInt64, topic, lambda m: got.append(m.data), 10, event_callbacks=callbacks
    )
    await feed(subscription, [1, 2, 3])
    await until(lambda: got == [1, 2, 3])
    assert seen == []
    paths = [source.woken_by for source in sources_of(executor).values() if "LOST" in source.where]
    assert paths == ["eventfd"]
