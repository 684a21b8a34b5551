"""Callback groups keep their meaning."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.callback_groups import (
    CallbackGroup,
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
)
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor
from tests.support.open_executor import runtime_of
from tests.support.rclpy_types import Node
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]


class Overlap:
    """Async callbacks that record how many of them run at once."""

    def __init__(self) -> None:
        self.running = 0
        self.most = 0
        self.done: list[str] = []

    async def run(self, name: str) -> None:
        self.running += 1
        self.most = max(self.most, self.running)
        await asyncio.sleep(0.005)
        self.running -= 1
        self.done.append(name)


def make_everything(node: Node, topic: str, group: CallbackGroup, overlap: Overlap) -> None:
    """Create a subscription, a service, a timer and a guard condition, each with work to do."""

    async def on_message(message: UInt64) -> None:
        await overlap.run("subscription")

    async def on_request(request: Any, response: Any) -> Any:
        await overlap.run("service")
        return response

    async def on_timer() -> None:
        await overlap.run("timer")

    async def on_guard() -> None:
        await overlap.run("guard")

    node.create_subscription(UInt64, topic, on_message, 10, callback_group=group)
    node.create_service(SetBool, topic, on_request, callback_group=group)
    client = node.create_client(SetBool, topic)
    node.create_timer(0.002, on_timer, callback_group=group)
    node.create_guard_condition(on_guard, callback_group=group).trigger()
    publisher = node.create_publisher(UInt64, topic, 10)
    for value in range(5):
        publisher.publish(UInt64(data=value))
    client.call_async(SetBool.Request())


async def test_async_callbacks_of_a_mutually_exclusive_group_never_overlap(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    overlap = Overlap()
    make_everything(node, topic, MutuallyExclusiveCallbackGroup(), overlap)
    await until(lambda: overlap.done.count("subscription") == 5)
    await until(lambda: {*overlap.done} == {"subscription", "service", "timer", "guard"})
    assert overlap.most == 1


async def test_async_callbacks_of_a_reentrant_group_overlap(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    overlap = Overlap()
    make_everything(node, topic, ReentrantCallbackGroup(), overlap)
    await until(lambda: overlap.done.count("subscription") == 5)
    await until(lambda: {*overlap.done} == {"subscription", "service", "timer", "guard"})
    assert overlap.most > 1


async def test_a_synchronous_callback_waits_for_the_async_one_of_its_group(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    group = MutuallyExclusiveCallbackGroup()
    order: list[str] = []
    release = asyncio.Event()

    async def slow(message: UInt64) -> None:
        order.append("begun")
        await release.wait()
        order.append("ended")

    def quick(message: UInt64) -> None:
        order.append("quick")

    node.create_subscription(UInt64, topic, slow, 10, callback_group=group)
    node.create_subscription(UInt64, f"{topic}/quick", quick, 10, callback_group=group)
    others: list[int] = []
    node.create_subscription(UInt64, f"{topic}/quick", lambda m: others.append(1), 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    quick_publisher = node.create_publisher(UInt64, f"{topic}/quick", 10)
    publisher.publish(UInt64())
    await until(lambda: order == ["begun"])
    quick_publisher.publish(UInt64())
    await until(lambda: others == [1])
    assert order == ["begun"]
    release.set()
    await until(lambda: order == ["begun", "ended", "quick"])


async def test_a_group_of_the_users_own_is_asked_for_every_callback(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    class Counting(CallbackGroup):
        open_now = 0
        begun = 0

        def can_execute(self, entity: Any) -> bool:
            return self.open_now == 0

        def beginning_execution(self, entity: Any) -> bool:
            assert self.open_now == 0
            self.open_now += 1
            self.begun += 1
            return True

        def ending_execution(self, entity: Any) -> None:
            self.open_now -= 1

    group = Counting()
    got: list[int] = []
    open_in_callback: list[int] = []

    def callback(message: UInt64) -> None:
        got.append(message.data)
        open_in_callback.append(group.open_now)

    others: dict[str, int] = {}
    node.create_timer(0.001, lambda: others.update(timer=group.open_now), callback_group=group)
    guard = node.create_guard_condition(
        lambda: others.update(guard=group.open_now), callback_group=group
    )
    guard.trigger()
    node.create_subscription(UInt64, topic, callback, 10, callback_group=group)
    publisher = node.create_publisher(UInt64, topic, 10)
    for value in range(5):
        publisher.publish(UInt64(data=value))
    await until(lambda: got == [0, 1, 2, 3, 4])
    await until(lambda: len(others) == 2)
    assert open_in_callback == [1] * 5
    assert others == {"timer": 1, "guard": 1}
    assert group.begun >= 5
    assert group.open_now == 0


async def test_a_cancelled_async_callback_frees_its_group(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    tasks: list[asyncio.Task[Any]] = []
    got: list[int] = []

    async def callback(message: UInt64) -> None:
        got.append(message.data)
        if message.data == 0:
            task = asyncio.current_task()
            assert task is not None
            tasks.append(task)
            await asyncio.sleep(DEADLINE_S)

    node.create_subscription(UInt64, topic, callback, 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    publisher.publish(UInt64(data=0))
    publisher.publish(UInt64(data=1))
    await until(lambda: tasks)
    assert got == [0]
    tasks[0].cancel()
    await until(lambda: got == [0, 1])


async def test_a_guard_condition_triggered_while_its_group_is_busy_runs_afterwards(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    release = asyncio.Event()
    order: list[str] = []

    async def hold(message: UInt64) -> None:
        order.append("held")
        await release.wait()
        order.append("free")

    group = MutuallyExclusiveCallbackGroup()
    node.create_subscription(UInt64, topic, hold, 10, callback_group=group)
    guard = node.create_guard_condition(lambda: order.append("guard"), callback_group=group)
    seen: list[int] = []
    free = node.create_guard_condition(
        lambda: seen.append(1), callback_group=ReentrantCallbackGroup()
    )
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: order == ["held"])
    guard.trigger()
    free.trigger()
    await until(lambda: seen)
    assert order == ["held"]
    release.set()
    await until(lambda: order == ["held", "free", "guard"])


async def test_a_parked_entity_may_be_destroyed(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    release = asyncio.Event()
    got: list[int] = []

    async def callback(message: UInt64) -> None:
        got.append(message.data)
        await release.wait()

    group = MutuallyExclusiveCallbackGroup()
    node.create_subscription(UInt64, topic, callback, 10, callback_group=group)
    parked = node.create_subscription(
        UInt64, f"{topic}/parked", lambda m: got.append(-1), 10, callback_group=group
    )
    seen: list[int] = []
    node.create_subscription(
        UInt64,
        f"{topic}/parked",
        lambda m: seen.append(1),
        10,
        callback_group=ReentrantCallbackGroup(),
    )
    node.create_publisher(UInt64, topic, 10).publish(UInt64(data=7))
    await until(lambda: got == [7])
    node.create_publisher(UInt64, f"{topic}/parked", 10).publish(UInt64())
    await until(lambda: seen)
    node.destroy_subscription(parked)
    await asyncio.sleep(0)
    release.set()
    await until(lambda: not runtime_of(executor).tasks)
    assert got == [7]
