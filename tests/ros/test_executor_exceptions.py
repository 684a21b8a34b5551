"""An exception goes to the exception handler, and the executor continues.

Errors for wrong uses of an executor say what to do.
"""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.task import Future
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap
from robotctl.ros.executor import RclCallFailed
from tests.ros.conftest import Peer
from tests.ros.open_executor import Bench, Node, engine_of, opened, populate
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until


@pytest.fixture
async def reported(node: Node) -> Any:
    """The reports of an executor with the node, as (exception text, where)."""
    told: list[tuple[str, str]] = []
    async with opened(node, lambda error, where: told.append((str(error), where))):
        yield told


async def test_an_exception_in_any_callback_reaches_the_handler_and_the_next_one_runs(
    reported: list[tuple[str, str]], node: Node, peer: Peer, topic: str
) -> None:
    def fail(*_: Any) -> None:
        raise ValueError("no")

    async def fail_later(*_: Any) -> None:
        await asyncio.sleep(0)
        raise ValueError("no")

    def fail_with_info(message: UInt64, info: Any) -> None:
        fail()

    def fail_alone(message: UInt64) -> None:
        fail()

    async def fail_slowly(message: UInt64) -> None:
        await fail_later()

    callbacks = SubscriptionEventCallbacks(matched=fail)
    node.create_subscription(UInt64, topic, fail_alone, 10, event_callbacks=callbacks)
    node.create_subscription(UInt64, topic, fail_with_info, 10)
    node.create_subscription(UInt64, topic, fail_slowly, 10)
    node.create_subscription(UInt64, topic, RawTap(fail), 10, raw=True)
    node.create_service(SetBool, topic, fail)
    node.create_service(SetBool, f"{topic}/later", fail_later)
    node.create_timer(0.01, fail)
    guard = node.create_guard_condition(fail)
    client = node.create_client(SetBool, topic)
    later = node.create_client(SetBool, f"{topic}/later")
    publisher = node.create_publisher(UInt64, topic, 10)

    def times(what: str) -> int:
        return sum(what in where for _, where in reported)

    subscriptions = ("fail_alone", "fail_with_info", "fail_slowly")
    kinds = (*subscriptions, "tap", "service", "/later", "timer", "guard", "MATCHED")
    for count in (1, 2):
        publisher.publish(UInt64())
        client.call_async(SetBool.Request())
        later.call_async(SetBool.Request())
        guard.trigger()
        await peer("open", topic=topic)

        def are_reported(count: int = count) -> bool:
            return all(times(kind) >= count for kind in kinds[:-1])

        await until(are_reported)
        await until(lambda: times("MATCHED"))
    assert {text for text, _ in reported} == {"no"}


async def test_without_a_handler_the_loops_own_is_told(node: Bench) -> None:
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, report: told.append(report))

    def fail() -> None:
        raise ValueError("no")

    async with opened(node):
        node.create_timer(0.005, fail)
        await until(lambda: len(told) >= 2)
    assert isinstance(told[0]["exception"], ValueError)
    assert "/tested: timer of 0.005 s" in told[0]["message"]


async def test_a_handler_that_raises_itself_is_reported_to_the_loop(
    context: Any, node: Node
) -> None:
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, report: told.append(report))

    def fail() -> None:
        raise ValueError("first")

    def handle(error: Exception, where: str) -> None:
        raise KeyError("second")

    async with AsyncioExecutor(context, on_exception=handle) as executor:
        executor.add_node(node)
        node.create_timer(0.005, fail)
        await until(lambda: len(told) >= 2)
    assert isinstance(told[0]["exception"], KeyError)
    assert isinstance(told[0]["exception"].__context__, ValueError)


async def test_a_service_that_returns_no_response_is_reported_and_serves_on(
    reported: list[tuple[str, str]], node: Node, peer: Peer, topic: str
) -> None:
    answers: list[Any] = [None, "text"]

    def answer(request: Any, response: Any) -> Any:
        return answers.pop(0) if answers else response

    node.create_service(SetBool, topic, answer)
    client = node.create_client(SetBool, topic)
    client.call_async(SetBool.Request())
    client.call_async(SetBool.Request())
    await until(lambda: len(reported) == 2)
    assert await peer("call", service=topic, data=True) == [[False, ""]]


async def test_a_failing_take_is_reported_and_tried_again_later(
    node: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.ros.executor.source.RETRY_AFTER_FAILED_TAKE_S", 0.01)
    told: list[str] = []
    got, tapped = node.hear(), node.tap(depth=10)
    async with opened(node, lambda error, where: told.append(str(error))) as executor:
        await asyncio.sleep(0)
        sources: Any = engine_of(executor).sources
        takers = {each: sources[each]._taker for each in (got.entity, tapped.entity)}

        def fail(*_: Any) -> None:
            raise RclCallFailed("cannot take")

        for each, taker in takers.items():
            sources[each]._taker = SimpleNamespace(take=fail, free=taker.free, info=taker.info)
        node.publish(3)
        await until(lambda: len(told) >= 4)
        assert (got, tapped) == ([], [])
        for each, taker in takers.items():
            sources[each]._taker = taker
        await until(lambda: got == tapped == [3])
    assert set(told) == {"cannot take"}


async def test_a_node_added_twice_answers_false(bench: Bench) -> None:
    assert bench.opened.add_node(bench) is False
    assert bench.opened.get_nodes() == [bench]
    attached: Any = bench.executor
    assert attached is bench.opened


async def test_a_node_of_another_live_executor_is_refused(bench: Bench, context: Any) -> None:
    other = AsyncioExecutor(context)
    with pytest.raises(RuntimeError, match="/tested belongs to another executor"):
        other.add_node(bench)
    bench.opened.remove_node(bench)
    assert other.add_node(bench)
    other.shutdown()
    spinning = SingleThreadedExecutor(context=context)
    spinning.add_node(bench)
    with pytest.raises(RuntimeError, match="call its remove_node first"):
        bench.opened.add_node(bench)
    spinning.shutdown()
    assert bench.opened.add_node(bench)


async def test_a_removed_node_is_left_alone_and_may_come_back(bench: Bench) -> None:
    got = bench.hear()
    bench.opened.remove_node(bench)
    assert bench.sources == {}
    bench.opened.remove_node(bench)
    bench.publish(1)
    await asyncio.sleep(0.02)
    assert got == []
    bench.opened.add_node(bench)
    await until(lambda: got == [1])


async def test_a_destroyed_node_leaves_the_executor(
    context: Any, executor: AsyncioExecutor, topic: str
) -> None:
    short_lived = Node("short_lived", context=context)
    populate(short_lived, topic, lambda _: None)
    executor.add_node(short_lived)
    await asyncio.sleep(0.01)
    short_lived.destroy_node()
    await until(lambda: short_lived not in executor.get_nodes())
    assert not [
        source for source in engine_of(executor).sources.values() if "short_lived" in source.where
    ]


async def test_a_closed_executor_says_that_it_is_closed(node: Bench) -> None:
    async with opened(node) as executor:
        client = node.create_client(SetBool, node.topic)
    for use in (lambda: executor.add_node(node), lambda: executor.create_task(print)):
        with pytest.raises(RuntimeError, match="was shut down; create a new one"):
            use()
    with pytest.raises(RuntimeError, match="was shut down; create a new one"):
        await executor.call(client, SetBool.Request(), timeout_s=1.0)
    with pytest.raises(RuntimeError, match="was shut down; create a new one"):
        await executor.__aenter__()
    await executor.serve()
    assert executor.shutdown() is True


async def test_an_executor_that_is_not_open_or_is_open_already_says_so(context: Any) -> None:
    executor = AsyncioExecutor(context)
    with pytest.raises(RuntimeError, match="not open; use: async with"):
        await executor.serve()
    async with executor:
        with pytest.raises(RuntimeError, match="open already"):
            await executor.__aenter__()
    with pytest.raises(RuntimeError, match="an AsyncioExecutor does not spin"):
        executor.spin_once(timeout_sec=0.0)


async def test_another_loop_is_refused(bench: Bench) -> None:
    client = bench.create_client(SetBool, bench.topic)

    def elsewhere() -> None:
        for waiting in (
            lambda: bench.opened.serve(),
            lambda: bench.opened.call(client, SetBool.Request(), timeout_s=1.0),
            lambda: bench.opened.wait_for_service(client, timeout_s=1.0),
            lambda: bench.opened.wait_for(Future(), timeout_s=1.0),
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
    with pytest.raises(RuntimeError, match=r"call rclpy\.init"):
        await AsyncioExecutor(Context()).__aenter__()


async def test_an_executor_shut_down_before_it_opened_serves_nobody(context: Any) -> None:
    executor = AsyncioExecutor(context)
    assert executor.shutdown() is True
    async with asyncio.timeout(DEADLINE_S):
        await executor.serve()


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
