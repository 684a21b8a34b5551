"""Every kind of entity under AsyncioExecutor, against a second process with plain rclpy."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from types import ModuleType
from typing import Any

import pytest
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.waitable import NumberOfEntities, Waitable
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap, rcl
from robotctl.testing.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Awaitable[Any]]
Feed = Callable[[Any, list[int]], Awaitable[None]]


def reliable(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


# Subscriptions.


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
    if not announced:  # another middleware might announce only what comes after the callback is set
        monkeypatch.setattr(rcl, "watch", lambda *_: None)
        monkeypatch.setattr(rcl, "unwatch", lambda *_: None)
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


# Services and clients.


async def test_a_synchronous_service_answers_the_other_process(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    def answer(request: Any, response: Any) -> Any:
        response.success, response.message = not request.data, "here"
        return response

    node.create_service(SetBool, topic, answer)
    assert await peer("call", service=topic, data=False, times=5) == [[True, "here"]] * 5


async def test_an_async_service_may_await_asyncio_and_another_service(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    await peer("serve", service=f"{topic}/inner")
    # In the callback group of the service itself: with an executor of rclpy this deadlocks.
    client = node.create_client(SetBool, f"{topic}/inner")
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)

    async def answer(request: Any, response: Any) -> Any:
        await asyncio.sleep(0.01)
        inner = await executor.call(client, request, timeout_s=DEADLINE_S)
        response.success, response.message = inner.success, f"{inner.message}, passed on"
        return response

    node.create_service(SetBool, topic, answer)
    assert await peer("call", service=topic, data=True) == [[True, "from the peer, passed on"]]


async def test_call_returns_the_response_of_the_other_process(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    await peer("serve", service=topic)
    client = node.create_client(SetBool, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    for data in (True, False):
        reply = await executor.call(client, SetBool.Request(data=data), timeout_s=DEADLINE_S)
        assert (reply.success, reply.message) == (data, "from the peer")


async def test_calls_in_flight_at_once_get_their_own_responses(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    await peer("serve", service=topic)
    client = node.create_client(SetBool, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    wanted = [number % 3 == 0 for number in range(8)]  # A service's queue holds ten.
    replies = await asyncio.gather(
        *(executor.call(client, SetBool.Request(data=d), timeout_s=DEADLINE_S) for d in wanted)
    )
    assert [reply.success for reply in replies] == wanted


async def test_call_async_of_rclpy_can_be_awaited_as_it_is(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    await peer("serve", service=topic)
    client = node.create_client(SetBool, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    async with asyncio.timeout(DEADLINE_S):
        assert (await client.call_async(SetBool.Request(data=True))).success


async def test_a_call_that_nobody_answers_ends_at_its_deadline_and_is_forgotten(
    executor: AsyncioExecutor, node: Node, topic: str
) -> None:
    client = node.create_client(SetBool, topic)
    with pytest.raises(TimeoutError, match=f"no response from service {topic} within 0.05 s"):
        await executor.call(client, SetBool.Request(), timeout_s=0.05)
    assert client._pending_requests == {}
    with pytest.raises(TimeoutError, match=f"nobody serves {topic} within 0.05 s"):
        await executor.wait_for_service(client, timeout_s=0.05)


async def test_a_response_after_the_deadline_disturbs_nothing(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    await peer("serve", service=topic, delay_s=0.2)
    client = node.create_client(SetBool, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    with pytest.raises(TimeoutError):
        await executor.call(client, SetBool.Request(), timeout_s=0.02)
    # The peer answers one after the other: with this response the late one has come as well.
    reply = await executor.call(client, SetBool.Request(data=True), timeout_s=DEADLINE_S)
    assert reply.success


async def test_parameter_services_answer_the_other_process(
    executor: AsyncioExecutor, node: Node, peer: Peer
) -> None:
    node.declare_parameter("laps", 3)
    assert await peer("get_parameter", node="/tested", name="laps") == 3
    assert await peer("set_parameter", node="/tested", name="laps", value=4)
    assert node.get_parameter("laps").value == 4


# Timers.


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
        # Best effort: the first ones may go before the two know each other.
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
    # Ten periods at once: as in rcl, one call, then the schedule goes on.
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


# Guard conditions and foreign Waitables: the wait-set thread.


async def test_a_guard_condition_runs_its_callback_for_a_trigger_from_any_thread(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    fired: list[asyncio.AbstractEventLoop] = []
    guard = node.create_guard_condition(lambda: fired.append(asyncio.get_running_loop()))
    guard.trigger()
    await until(lambda: len(fired) == 1)
    await asyncio.to_thread(guard.trigger)
    await until(lambda: len(fired) == 2)
    assert set(fired) == {asyncio.get_running_loop()}


async def test_an_async_guard_condition_callback_may_await(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    fired: list[int] = []

    async def callback() -> None:
        await asyncio.sleep(0.001)
        fired.append(1)

    node.create_guard_condition(callback).trigger()
    await until(lambda: fired == [1])


class ForeignWaitable(Waitable):
    """A Waitable as a package outside rclpy would write it: around a subscription."""

    def __init__(self, node: Node, topic: str) -> None:
        super().__init__(node.default_callback_group)
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
def foreign(executor: AsyncioExecutor, node: Node, topic: str) -> Iterator[ForeignWaitable]:
    waitable = ForeignWaitable(node, f"{topic}/foreign")
    node.add_waitable(waitable)
    yield waitable
    node.remove_waitable(waitable)
    for handler in waitable.subscription.event_handlers:
        node.remove_waitable(handler)
    waitable.subscription.destroy()


async def test_a_foreign_waitable_is_waited_for_taken_and_executed(
    foreign: ForeignWaitable, node: Node, topic: str, until: Until
) -> None:
    publisher = node.create_publisher(UInt64, f"{topic}/foreign", 10)
    for value in (1, 2, 3):
        publisher.publish(UInt64(data=value))
        await until(lambda value=value: foreign.executed == list(range(1, value + 1)))


async def test_a_foreign_waitable_parked_behind_its_group_does_not_turn_the_loop(
    foreign: ForeignWaitable,
    node: Node,
    topic: str,
    until: Until,
    comes_to_rest: Callable[[], Awaitable[bool]],
) -> None:
    release = asyncio.Event()
    busy: list[int] = []

    async def hold(message: UInt64) -> None:
        busy.append(1)
        await release.wait()

    node.create_subscription(UInt64, topic, hold, 10)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: busy)
    publisher = node.create_publisher(UInt64, f"{topic}/foreign", 10)
    publisher.publish(UInt64(data=1))
    publisher.publish(UInt64(data=2))
    assert await comes_to_rest()
    assert foreign.executed == []
    release.set()
    await until(lambda: foreign.executed == [1, 2])


# QoS events.


async def test_matched_events_come_when_the_other_side_appears_and_goes(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[tuple[int, int]] = []
    callbacks = SubscriptionEventCallbacks(
        matched=lambda event: seen.append((event.current_count, event.current_count_change))
    )
    node.create_subscription(UInt64, topic, lambda _: None, 10, event_callbacks=callbacks)
    await peer("offer", topic=topic)
    await until(lambda: seen == [(1, 1)])
    await peer("withdraw", topic=topic)
    await until(lambda: seen == [(1, 1), (0, -1)])


async def test_a_match_from_before_the_node_was_added_is_told_once(
    context: Any, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[int] = []
    await peer("listen", topic=topic)
    callbacks = PublisherEventCallbacks(matched=lambda event: seen.append(event.current_count))
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
    callbacks = SubscriptionEventCallbacks(
        incompatible_qos=lambda event: seen.append(event.total_count_change)
    )
    node.create_subscription(UInt64, topic, lambda _: None, reliable(10), event_callbacks=callbacks)
    await peer("offer", topic=topic, reliable=False)
    await until(lambda: seen == [1])


async def test_a_missed_deadline_is_told(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, until: Until
) -> None:
    seen: list[int] = []
    qos = QoSProfile(depth=10, deadline=Duration(nanoseconds=50_000_000))
    callbacks = SubscriptionEventCallbacks(
        deadline=lambda event: seen.append(event.total_count_change)
    )
    node.create_subscription(UInt64, topic, lambda _: None, qos, event_callbacks=callbacks)
    await peer("offer", topic=topic, deadline_s=0.05)
    await peer("publish", topic=topic, values=[1])
    await until(lambda: sum(seen) >= 2)


async def test_message_lost_events_are_watched_without_inventing_any(
    executor: AsyncioExecutor, node: Node, feed: Feed, topic: str, until: Until
) -> None:
    # With this middleware the event never fires (sequence gaps tell instead), so what can be
    # shown is that it is attached and that nothing is made up.
    seen: list[object] = []
    got: list[int] = []
    callbacks = SubscriptionEventCallbacks(message_lost=seen.append)
    subscription = node.create_subscription(
        UInt64, topic, lambda m: got.append(m.data), 10, event_callbacks=callbacks
    )
    await feed(subscription, [1, 2, 3])
    await until(lambda: got == [1, 2, 3])
    assert seen == []
    paths = [source.path for source in executor._sources.values() if "LOST" in source.where]
    assert paths == ["eventfd"]


# Actions.


async def test_an_action_server_runs_a_goal_of_the_other_process(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    until: Until,
    borrowed_action: ModuleType,
) -> None:
    count = borrowed_action.Count

    async def execute(handle: Any) -> Any:
        # The goal may come before we know that its client listens to the feedback.
        await until(lambda: node.count_subscribers(f"{topic}/_action/feedback"))
        for number in range(handle.request.value):
            await asyncio.sleep(0.005)
            handle.publish_feedback(count.Feedback(number))
        handle.succeed()
        return count.Result(sum(range(handle.request.value)))

    server = ActionServer(node, count, topic, execute)
    report = await peer("run_goal", action=topic, value=5)
    server.destroy()
    assert report == {
        "accepted": True,
        "feedback": [0, 1, 2, 3, 4],
        "succeeded": True,
        "canceled": False,
        "result": 10,
    }


async def test_an_action_server_refuses_and_cancels_goals(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, borrowed_action: ModuleType
) -> None:
    count = borrowed_action.Count

    async def execute(handle: Any) -> Any:
        number = 0
        while not handle.is_cancel_requested:
            handle.publish_feedback(count.Feedback(number))
            number += 1
            await asyncio.sleep(0.005)
        handle.canceled()
        return count.Result(-1)

    server = ActionServer(
        node,
        count,
        topic,
        execute,
        goal_callback=lambda goal: GoalResponse.ACCEPT if goal.value else GoalResponse.REJECT,
        cancel_callback=lambda _: CancelResponse.ACCEPT,
    )
    assert (await peer("run_goal", action=topic, value=0))["accepted"] is False
    report = await peer("run_goal", action=topic, value=1, cancel_after=3)
    server.destroy()
    assert report["cancelling"] == 1
    assert report["canceled"] is True
    assert report["result"] == -1


async def test_finished_goals_are_forgotten_after_their_result_timeout(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    until: Until,
    borrowed_action: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("robotctl.ros.actions.EXPIRY_POLL_S", 0.05)
    count = borrowed_action.Count

    async def execute(handle: Any) -> Any:
        handle.succeed()
        return count.Result()

    server = ActionServer(node, count, topic, execute, result_timeout=0)
    for _ in range(2):
        await peer("run_goal", action=topic, value=1)
        await until(lambda: not server._goal_handles)
        await asyncio.sleep(0.2)  # Until nothing looks for expired goals any more.
    server.destroy()


async def test_an_action_client_sends_follows_and_cancels_goals(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    until: Until,
    borrowed_action: ModuleType,
) -> None:
    count = borrowed_action.Count
    await peer("serve_action", action=topic)
    client = ActionClient(node, count, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    async with asyncio.timeout(DEADLINE_S):
        refused = await client.send_goal_async(count.Goal(1001))
        assert not refused.accepted

        feedback: list[int] = []
        handle = await client.send_goal_async(
            count.Goal(5), feedback_callback=lambda m: feedback.append(m.feedback.value)
        )
        result = await handle.get_result_async()
        assert result.result.value == 10
        await until(lambda: feedback == [0, 1, 2, 3, 4])

        live: list[int] = []
        endless = await client.send_goal_async(
            count.Goal(1000), feedback_callback=lambda m: live.append(m.feedback.value)
        )
        await until(lambda: len(live) >= 5)
        response = await endless.cancel_goal_async()
        assert len(response.goals_canceling) == 1
        assert (await endless.get_result_async()).result.value < sum(range(1000))
    client.destroy()


# Entities that come and go.


async def test_entities_may_be_created_and_destroyed_in_any_callback(
    executor: AsyncioExecutor, node: Node, peer: Peer, feed: Feed, topic: str, until: Until
) -> None:
    got: list[int] = []
    made: list[Any] = []

    def first(message: UInt64) -> None:
        got.append(message.data)
        if len(got) == 1:
            made.append(node.create_subscription(UInt64, f"{topic}/second", second, 10))
            made.append(node.create_timer(0.005, on_timer))

    def second(message: UInt64) -> None:
        got.append(message.data)
        node.destroy_subscription(made[0])

    def on_timer() -> None:
        got.append(-1)
        node.destroy_timer(made[1])

    subscription = node.create_subscription(UInt64, topic, first, 10)
    await feed(subscription, [1])
    await peer("publish", topic=f"{topic}/second", values=[2, 3, 4])
    await until(lambda: len(got) >= 3)
    await peer("publish", topic=topic, values=[9])
    await until(lambda: 9 in got)
    # Of the second topic one message came, because its callback destroyed the subscription.
    assert sorted(got) == [-1, 1, 2, 9]


async def test_a_subscription_destroyed_with_messages_waiting_delivers_none_of_them(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    doomed = node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 100)
    publisher = node.create_publisher(UInt64, topic, 100)
    reference: list[int] = []
    node.create_subscription(UInt64, topic, lambda m: reference.append(m.data), 100)
    await asyncio.sleep(0.01)  # Attached, and idle.
    for value in range(50):
        publisher.publish(UInt64(data=value))
    # After it was announced, and before its turn in the same round of the loop.
    asyncio.get_running_loop().call_soon(node.destroy_subscription, doomed)
    await until(lambda: len(reference) == 50)
    assert got == []


async def test_each_entity_names_its_path_at_debug_level(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("DEBUG", "robotctl.ros.executor")
    node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 10, raw=True)
    node.create_timer(1.0, lambda: None)
    node.create_guard_condition(lambda: None)
    node.create_client(SetBool, topic)
    await until(lambda: len(caplog.messages) >= 4)
    text = "\n".join(caplog.messages)
    assert f"/tested: tap of {topic} comes by eventfd, collected" in text
    assert "/tested: timer of 1 s" in text
    assert "comes by timerfd" in text
    assert "guard condition" in text
    assert "comes by wait-set thread" in text
    assert f"/tested: client {topic} comes by eventfd" in text
