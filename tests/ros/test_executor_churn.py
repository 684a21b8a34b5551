"""Entities that are created and destroyed while an executor runs."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Awaitable, Callable
from types import ModuleType
from typing import Any

import pytest
from rclpy.action.server import ActionServer
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap
from tests.support.open_executor import sources_of
from tests.support.rclpy_types import Node

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Awaitable[Any]]
Feed = Callable[[Any, list[int]], Awaitable[None]]


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
    assert f"/tested: tap of {topic} is woken by eventfd, collected" in text
    assert "/tested: timer of 1 s" in text
    assert "is woken by timerfd" in text
    assert "guard condition" in text
    assert "is woken by wait-set thread" in text
    assert f"/tested: client {topic} is woken by eventfd" in text


@pytest.mark.parametrize("from_thread", [False, True])
async def test_entities_destroyed_with_something_pending_disturb_nothing(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    from_thread: bool,
    borrowed_action: ModuleType,
) -> None:
    alive: list[int] = []
    node.create_timer(0.002, lambda: alive.append(1))
    publisher = node.create_publisher(UInt64, topic, 100)
    for _ in range(30):
        group: list[tuple[Any, Callable[..., object]]] = [
            (
                node.create_subscription(UInt64, topic, lambda m: None, 10),
                node.destroy_subscription,
            ),
            (
                node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 10, raw=True),
                node.destroy_subscription,
            ),
            (node.create_service(SetBool, topic, lambda q, r: r), node.destroy_service),
            (node.create_client(SetBool, topic), node.destroy_client),
            (node.create_timer(0.001, lambda: None), node.destroy_timer),
            (node.create_guard_condition(lambda: None), node.destroy_guard_condition),
        ]
        server = ActionServer(node, borrowed_action.Count, topic, lambda handle: None)
        await asyncio.sleep(0)  # Attached.
        publisher.publish(UInt64())
        group[3][0].call_async(SetBool.Request())
        group[5][0].trigger()

        def destroy(group: Any = group, server: Any = server) -> None:
            for entity, destroyer in group:
                destroyer(entity)
            server.destroy()

        if from_thread:
            thread = threading.Thread(target=destroy)
            thread.start()
            await asyncio.sleep(0.001)
            thread.join()
        else:
            destroy()
    count = len(alive)
    await until(lambda: len(alive) >= count + 3)
    await until(lambda: len(sources_of(executor)) < 20)
