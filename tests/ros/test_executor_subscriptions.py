"""Subscriptions and publishers under AsyncioExecutor, against a process with plain rclpy.

QoS events under AsyncioExecutor, against a process with plain rclpy.
How often AsyncioExecutor takes from a subscription, and that no message is left behind.
Guard conditions and foreign Waitables under AsyncioExecutor: the wait-set thread.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.waitable import NumberOfEntities, Waitable
from std_msgs.msg import String, UInt64

from robotctl.ros import AsyncioExecutor, RawTap
from robotctl.ros.executor import announcements, subscriptions
from robotctl.ros.executor.raw_tap import LARGE_BYTES, SerializedTaker
from tests.ros.conftest import Feed, Peer
from tests.ros.open_executor import Bench, Node, comes_to_rest, opened
from tests.support.waiting import loop_until as until
from tests.support.waiting import until as wait_until


async def test_a_typed_subscription_delivers_every_message_in_order(
    bench: Bench, feed: Feed
) -> None:
    got = bench.hear(depth=1000)
    await feed(got.entity, list(range(500)))
    await until(lambda: len(got) >= 500)
    assert got == list(range(500))


async def test_a_callback_of_two_arguments_gets_the_message_info(bench: Bench, feed: Feed) -> None:
    got: list[tuple[int, dict[str, int]]] = []
    subscription = bench.listen(lambda message, info: got.append((message, info)))
    await feed(subscription, [5, 6])
    await until(lambda: len(got) == 2)
    assert [info["publication_sequence_number"] for _, info in got] == [1, 2]
    assert 0 < got[0][1]["source_timestamp"] <= got[0][1]["received_timestamp"]


async def test_a_raw_subscription_gets_the_serialized_bytes(bench: Bench, feed: Feed) -> None:
    got: list[bytes] = []
    subscription = bench.listen(got.append, raw=True)
    await feed(subscription, [7])
    await until(lambda: got)
    assert deserialize_message(got[0], UInt64).data == 7


async def test_a_tap_tells_two_publishers_apart_and_numbers_the_messages_of_each(
    bench: Bench, peer: Peer
) -> None:
    got: list[tuple[bytes, int, int, int, bytes]] = []
    tap = RawTap(lambda *item: got.append(item))
    subscription = bench.listen(tap, depth=100, raw=True)
    bench.publish(100, 101, 102)
    await peer("open", topic=bench.topic)
    await until(lambda: subscription.get_publisher_count() == 2)
    await peer("publish", topic=bench.topic, values=[0, 1, 2])
    await until(lambda: len(got) == 6)
    by_publisher: dict[bytes, list[tuple[int, int]]] = {}
    for data, received_ns, source_ns, sequence, gid in got:
        assert 0 < source_ns <= received_ns
        assert len(gid) == 16
        value = deserialize_message(data, UInt64).data
        by_publisher.setdefault(gid, []).append((sequence, value))
    theirs, ours = sorted(by_publisher.values())
    assert theirs == [(1, 0), (2, 1), (3, 2)]
    assert ours == [(1, 100), (2, 101), (3, 102)]
    infos = bench.get_publishers_info_by_topic(bench.topic)
    assert set(by_publisher) == {bytes(info.endpoint_gid[:16]) for info in infos}


async def test_a_tap_takes_messages_of_growing_and_shrinking_size(bench: Bench) -> None:
    got: list[bytes] = []
    bench.create_subscription(
        String, bench.topic, RawTap(lambda data, *_: got.append(data)), 100, raw=True
    )
    publisher = bench.create_publisher(String, bench.topic, 100)
    sizes = [1, 5000, 3, 200_000, 0, 200_001]
    for size in sizes:
        publisher.publish(String(data="x" * size))
    await until(lambda: len(got) == len(sizes))
    assert [len(deserialize_message(data, String).data) for data in got] == sizes


@pytest.mark.parametrize("announced", [True, False])
async def test_messages_from_before_the_node_was_added_are_delivered(
    node: Bench, feed: Feed, monkeypatch: pytest.MonkeyPatch, announced: bool
) -> None:
    if not announced:  # another middleware may announce later messages only
        monkeypatch.setattr(announcements, "watch", lambda *_: None)
        monkeypatch.setattr(announcements, "unwatch", lambda *_: None)
    got = node.hear(depth=100)
    await feed(got.entity, [1, 2, 3])
    async with opened(node):
        await until(lambda: got == [1, 2, 3])


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
    bench: Bench, peer: Peer
) -> None:
    seen: list[tuple[int, int]] = []

    def tell(event: Any) -> None:
        seen.append((event.current_count, event.current_count_change))

    callbacks = SubscriptionEventCallbacks(matched=tell)
    bench.listen(lambda _: None, event_callbacks=callbacks)
    await peer("offer", topic=bench.topic)
    await until(lambda: seen == [(1, 1)])
    await peer("withdraw", topic=bench.topic)
    await until(lambda: seen == [(1, 1), (0, -1)])


async def test_an_incompatible_offer_from_before_the_node_was_added_counts_as_one(
    node: Bench, peer: Peer
) -> None:
    seen: list[Any] = []
    await meet_incompatible(node, peer, node.topic, seen.append)
    await until(lambda: node.count_publishers(node.topic))
    async with opened(node):
        await until(lambda: seen)
    event = seen[0]
    assert (event.total_count, event.total_count_change) == (1, 1)
    assert event.last_policy_kind == QoSPolicyKind.RELIABILITY


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


async def test_a_message_is_taken_once_and_nothing_else(bench: Bench, takes: list[bool]) -> None:
    got = bench.hear()
    await until(lambda: takes == [False])  # what was there before the executor
    for value in range(5):
        bench.publish(value)
        await until(lambda: len(got) > value)  # noqa: B023
    assert takes == [False, *[True] * 5]


async def test_a_middleware_that_does_not_count_messages_is_asked_until_none_is_left(
    bench: Bench, takes: list[bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscriptions, "counts_each_message", lambda: False)
    got = bench.hear()
    await until(lambda: takes == [False])
    bench.publish(1)
    await until(lambda: got)
    assert takes == [False, True, False]


async def test_a_guard_condition_runs_its_callback_for_a_trigger_from_any_thread(
    bench: Bench,
) -> None:
    fired: list[asyncio.AbstractEventLoop] = []
    guard = bench.create_guard_condition(lambda: fired.append(asyncio.get_running_loop()))
    guard.trigger()
    await until(lambda: len(fired) == 1)
    await asyncio.to_thread(guard.trigger)
    await until(lambda: len(fired) == 2)
    assert set(fired) == {asyncio.get_running_loop()}


class ForeignWaitable(Waitable):
    """A Waitable as a package outside rclpy would write it: around a subscription."""

    def __init__(self, node: Node, topic: str) -> None:
        super().__init__(node.default_callback_group)  # type: ignore[no-untyped-call]
        self.subscription = node.create_subscription(UInt64, topic, lambda _: None, 10)
        node._subscriptions.remove(self.subscription)
        self.index: int | None = None
        self.executed: list[int] = []

    def __enter__(self) -> None:
        self.subscription.handle.__enter__()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.subscription.handle.__exit__(None, None, None)

    def is_ready(self, wait_set: Any) -> bool:
        return self.index is not None and wait_set.is_ready("subscription", self.index)

    def take_data(self) -> Any:
        return self.subscription.handle.take_message(UInt64, False)

    async def execute(self, taken_data: Any) -> None:
        await asyncio.sleep(0.001)
        self.executed.append(taken_data[0].data)

    def get_num_entities(self) -> NumberOfEntities:
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        self.index = wait_set.add_subscription(self.subscription.handle)


@pytest.fixture
def waitable(node: Bench) -> Iterator[ForeignWaitable]:
    made = ForeignWaitable(node, f"{node.topic}/foreign")
    node.add_waitable(made)
    yield made
    node.remove_waitable(made)
    handlers: Any = made.subscription.event_handlers
    for handler in handlers:
        node.remove_waitable(handler)
    made.subscription.destroy()


@pytest.fixture
def foreign(executor: AsyncioExecutor, waitable: ForeignWaitable) -> ForeignWaitable:
    return waitable


async def test_a_foreign_waitable_is_waited_for_taken_and_executed(
    foreign: ForeignWaitable, node: Bench
) -> None:
    for value in (1, 2, 3):
        node.publish(value, topic=f"{node.topic}/foreign")

        def is_executed(value: int = value) -> bool:
            return foreign.executed == list(range(1, value + 1))

        await until(is_executed)


@pytest.mark.parametrize("method", ["get_num_entities", "add_to_wait_set", "is_ready", "take_data"])
async def test_a_foreign_waitable_that_raises_is_reported_and_disturbs_no_guard_condition(
    node: Bench, waitable: ForeignWaitable, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    def fail(*_: object) -> None:
        raise ValueError("no")

    monkeypatch.setattr(waitable, method, fail)
    reported: list[str] = []
    fired: list[int] = []
    async with opened(node, lambda error, where: reported.append(str(error))):
        node.publish(1, topic=f"{node.topic}/foreign")
        guard = node.create_guard_condition(lambda: fired.append(1))
        await until(lambda: reported)
        assert await comes_to_rest()
        guard.trigger()
        await until(lambda: fired)
        monkeypatch.undo()
        await until(lambda: waitable.executed == [1])
    assert set(reported) == {"no"}


async def test_a_match_from_before_the_node_was_added_is_told_once(node: Bench, peer: Peer) -> None:
    seen: list[int] = []

    def tell(event: Any) -> None:
        seen.append(event.current_count)

    await peer("listen", topic=node.topic)
    callbacks = PublisherEventCallbacks(matched=tell)
    publisher = node.create_publisher(UInt64, node.topic, 10, event_callbacks=callbacks)
    await until(publisher.get_subscription_count)
    reference: list[int] = []
    async with opened(node):
        node.create_timer(0.01, lambda: reference.append(1))
        await until(lambda: seen and len(reference) >= 5)
    assert seen == [1]


async def test_what_an_executor_of_rclpy_has_told_is_not_told_again(
    context: Any, node: Bench, peer: Peer
) -> None:
    seen: list[tuple[int, int, int]] = []

    def tell(event: Any) -> None:
        seen.append((event.total_count, event.total_count_change, event.current_count_change))

    callbacks = PublisherEventCallbacks(matched=tell)
    node.create_publisher(UInt64, node.topic, 10, event_callbacks=callbacks)
    await peer("listen", topic=node.topic)
    theirs = SingleThreadedExecutor(context=context)
    theirs.add_node(node)

    def tells() -> bool:
        theirs.spin_once(timeout_sec=0.01)
        return bool(seen)

    await asyncio.to_thread(wait_until, tells)
    theirs.remove_node(node)
    theirs.shutdown()
    assert seen == [(1, 1, 1)]
    local, turns = node.listen(lambda _: None), node.ticks()
    async with opened(node):
        await until(lambda: len(seen) >= 2)
    turns.clear()
    async with opened(node):  # Nor by a publisher of this process.
        await until(lambda: len(turns) >= 5)
    assert seen == [(1, 1, 1), (2, 1, 1)]
    node.destroy_subscription(local)


async def test_an_event_announced_after_it_was_taken_is_not_told_again(
    bench: Bench, peer: Peer
) -> None:
    seen: list[int] = []

    def tell(event: Any) -> None:
        seen.append(event.total_count_change)

    await meet_incompatible(bench, peer, bench.topic, tell)
    await until(lambda: seen == [1])
    (announced,) = (source for source in bench.sources.values() if source.entity.callback is tell)
    announced.resume()
    reference = bench.ticks()
    await until(lambda: len(reference) >= 5)
    assert seen == [1]


async def test_a_missed_deadline_is_told(bench: Bench, peer: Peer) -> None:
    seen: list[int] = []
    qos = QoSProfile(depth=10, deadline=Duration(nanoseconds=50_000_000))

    def tell(event: Any) -> None:
        seen.append(event.total_count_change)

    callbacks = SubscriptionEventCallbacks(deadline=tell)
    bench.create_subscription(UInt64, bench.topic, lambda _: None, qos, event_callbacks=callbacks)
    await peer("offer", topic=bench.topic, deadline_s=0.05)
    await peer("publish", topic=bench.topic, values=[1])
    await until(lambda: sum(seen) >= 2)


async def test_message_lost_events_are_watched_without_inventing_any(
    bench: Bench, feed: Feed
) -> None:
    # This middleware never sends the event (sequence gaps show losses instead). The test shows only
    # that it is attached and that no event is invented.
    seen: list[object] = []
    got = bench.hear(event_callbacks=SubscriptionEventCallbacks(message_lost=seen.append))
    await feed(got.entity, [1, 2, 3])
    await until(lambda: got == [1, 2, 3])
    assert seen == []
    paths = [source.woken_by for source in bench.sources.values() if "LOST" in source.where]
    assert paths == ["eventfd"]


async def test_the_memory_of_a_large_message_is_looked_after_at_once(
    bench: Bench, takes: list[bool]
) -> None:
    got: list[str] = []
    bench.create_subscription(String, bench.topic, lambda message: got.append(message.data), 10)
    publisher = bench.create_publisher(String, bench.topic, 10)
    await until(lambda: takes == [False])
    publisher.publish(String(data="x" * LARGE_BYTES))
    await until(lambda: got)
    assert takes == [False, True, False]


async def test_messages_that_waited_for_their_callback_group_are_all_delivered(
    bench: Bench, takes: list[bool]
) -> None:
    busy, free = asyncio.Event(), asyncio.Event()

    async def occupy(_: UInt64) -> None:
        busy.set()
        await free.wait()

    bench.listen(occupy, f"{bench.topic}_first")
    got = bench.hear()
    await until(lambda: takes == [False, False])
    bench.publish(0, topic=f"{bench.topic}_first")
    await busy.wait()
    bench.publish(*range(5))
    engine = bench.opened._engine
    await until(lambda: engine is not None and engine.runtime._parked)
    assert got == []
    free.set()
    await until(lambda: len(got) == 5)
    assert got == list(range(5))


async def test_a_foreign_waitable_parked_behind_its_group_does_not_turn_the_loop(
    foreign: ForeignWaitable, node: Bench
) -> None:
    release = asyncio.Event()
    busy: list[int] = []

    async def hold(message: UInt64) -> None:
        busy.append(1)
        await release.wait()

    node.listen(hold)
    node.publish(0)
    await until(lambda: busy)
    node.publish(1, 2, topic=f"{node.topic}/foreign")
    assert await comes_to_rest()
    assert foreign.executed == []
    release.set()
    await until(lambda: foreign.executed == [1, 2])
