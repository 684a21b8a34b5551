"""Errors for wrong uses of an executor say what to do."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor
from tests.support.open_executor import populate, sources_of
from tests.support.rclpy_types import Node
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]


async def test_a_node_added_twice_answers_false(executor: AsyncioExecutor, node: Node) -> None:
    assert executor.add_node(node) is False
    assert executor.get_nodes() == [node]
    attached: Any = node.executor
    assert attached is executor


async def test_a_node_of_another_live_executor_is_refused(
    context: Any, node: Node, executor: AsyncioExecutor
) -> None:
    other = AsyncioExecutor(context)
    with pytest.raises(RuntimeError, match="/tested belongs to another executor"):
        other.add_node(node)
    executor.remove_node(node)
    assert other.add_node(node)
    other.shutdown()
    spinning = SingleThreadedExecutor(context=context)
    spinning.add_node(node)
    with pytest.raises(RuntimeError, match="call its remove_node first"):
        executor.add_node(node)
    spinning.shutdown()
    assert executor.add_node(node)


async def test_a_removed_node_is_left_alone_and_may_come_back(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 10)
    publisher = node.create_publisher(UInt64, topic, 10)
    executor.remove_node(node)
    assert sources_of(executor) == {}
    executor.remove_node(node)
    publisher.publish(UInt64(data=1))
    await asyncio.sleep(0.02)
    assert got == []
    executor.add_node(node)
    await until(lambda: got == [1])


async def test_a_destroyed_node_leaves_the_executor(
    context: Any, executor: AsyncioExecutor, topic: str, until: Until
) -> None:
    short_lived = Node("short_lived", context=context)
    populate(short_lived, topic, lambda _: None)
    executor.add_node(short_lived)
    await asyncio.sleep(0.01)
    short_lived.destroy_node()
    await until(lambda: short_lived not in executor.get_nodes())
    assert not [source for source in sources_of(executor).values() if "short_lived" in source.where]


async def test_a_closed_executor_says_that_it_is_closed(
    context: Any, node: Node, topic: str
) -> None:
    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        client = node.create_client(SetBool, topic)
    for use in (lambda: executor.add_node(node), lambda: executor.create_task(print)):
        with pytest.raises(RuntimeError, match="was shut down; create a new one"):
            use()
    with pytest.raises(RuntimeError, match="was shut down; create a new one"):
        await executor.call(client, SetBool.Request(), timeout_s=1.0)
    with pytest.raises(RuntimeError, match="was shut down; create a new one"):
        await executor.__aenter__()
    await executor.serve()
    assert executor.shutdown() is True


async def test_an_executor_shut_down_before_it_opened_serves_nobody(context: Any) -> None:
    executor = AsyncioExecutor(context)
    assert executor.shutdown() is True
    async with asyncio.timeout(DEADLINE_S):
        await executor.serve()


async def test_an_executor_that_is_not_open_or_is_open_already_says_so(context: Any) -> None:
    executor = AsyncioExecutor(context)
    with pytest.raises(RuntimeError, match="not open; use: async with"):
        await executor.serve()
    async with executor:
        with pytest.raises(RuntimeError, match="open already"):
            await executor.__aenter__()
    with pytest.raises(RuntimeError, match="an AsyncioExecutor does not spin"):
        executor.spin_once(timeout_sec=0.0)


async def test_two_tasks_that_open_one_executor_at_once_open_it_once(
    context: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.ros.executor.announcements._passed", False)
    executor = AsyncioExecutor(context)
    first = asyncio.create_task(executor.__aenter__())
    await asyncio.sleep(0)
    with pytest.raises(RuntimeError, match="open already"):
        await executor.__aenter__()
    assert await first is executor
    await executor.__aexit__(None, None, None)


async def test_another_loop_is_refused(executor: AsyncioExecutor, node: Node, topic: str) -> None:
    client = node.create_client(SetBool, topic)

    def elsewhere() -> None:
        for waiting in (
            lambda: executor.serve(),
            lambda: executor.call(client, SetBool.Request(), timeout_s=1.0),
            lambda: executor.wait_for_service(client, timeout_s=1.0),
            lambda: executor.wait_for(Future(), timeout_s=1.0),
        ):

            async def use(waiting: Any = waiting) -> None:
                await waiting()

            with pytest.raises(RuntimeError, match="another event loop"):
                asyncio.run(use())

    await asyncio.to_thread(elsewhere)


async def test_a_client_of_a_node_that_is_not_here_is_refused(
    context: Any, node: Node, topic: str
) -> None:
    client = node.create_client(SetBool, topic)
    async with AsyncioExecutor(context) as executor:
        with pytest.raises(RuntimeError, match="call add_node first"):
            await executor.call(client, SetBool.Request(), timeout_s=1.0)


async def test_a_context_that_is_not_initialized_is_refused() -> None:
    from rclpy.context import Context

    with pytest.raises(RuntimeError, match=r"call rclpy\.init"):
        await AsyncioExecutor(Context()).__aenter__()
