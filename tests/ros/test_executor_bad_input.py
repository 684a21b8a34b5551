"""What an executor says and does where something is wrong around it."""

from __future__ import annotations

import asyncio
import ctypes
import os
import re
import struct
import threading
import time
from collections.abc import Awaitable, Callable
from enum import Enum
from subprocess import CompletedProcess
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from rclpy.action import ActionServer
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap, rcl
from robotctl.testing.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Awaitable[Any]]


# The platform.


@pytest.fixture
def unproven(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robotctl.ros.proof._proven", False)


async def open_and_close(context: Any) -> None:
    async with AsyncioExecutor(context):
        pass


async def test_the_path_is_proven_by_a_message_before_the_executor_opens(
    context: Any, unproven: None
) -> None:
    await open_and_close(context)
    from robotctl.ros import proof

    assert proof._proven


async def test_a_platform_without_eventfd_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(os, "eventfd")
    with pytest.raises(rcl.UnsupportedPlatform, match="needs Linux with eventfd"):
        await open_and_close(context)


async def test_a_32_bit_platform_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rcl.ctypes, "sizeof", lambda _: 4)
    with pytest.raises(rcl.UnsupportedPlatform, match="needs a 64-bit Python"):
        await open_and_close(context)


async def test_a_middleware_without_callbacks_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    unsupported = 3
    monkeypatch.setattr(rcl, "_setter", lambda _: lambda *_: unsupported)
    with pytest.raises(rcl.UnsupportedPlatform, match="set RMW_IMPLEMENTATION=rmw_fastrtps_cpp"):
        await open_and_close(context)


async def test_a_middleware_whose_callback_never_comes_is_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    harmless = ctypes.cast(ctypes.CDLL(None).getpid, ctypes.c_void_p).value
    monkeypatch.setattr(rcl, "_eventfd_write", lambda: harmless)
    monkeypatch.setattr("robotctl.ros.proof.PROOF_TIMEOUT_S", 0.1)
    with pytest.raises(rcl.UnsupportedPlatform, match="did not announce a message to itself"):
        await open_and_close(context)


async def test_message_structures_of_another_ros_are_refused(
    context: Any, unproven: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As if there were a field less at the front.
    monkeypatch.setattr(rcl, "_MESSAGE_INFO", struct.Struct("@8xqqQQQ8s"))
    with pytest.raises(rcl.UnsupportedPlatform, match="not those of ROS 2 Jazzy"):
        await open_and_close(context)


def test_a_ros_without_the_function_is_named() -> None:
    class Newer(Enum):
        SIGNAL = ("librcl.so", "rcl_no_such_function")

    with pytest.raises(rcl.UnsupportedPlatform, match="this ROS has no rcl_no_such_function"):
        rcl.watch(Newer.SIGNAL, 0, 0)


NO_FILES = """
import asyncio, os, resource, rclpy
from contextlib import suppress
from std_msgs.msg import UInt64
from robotctl.ros import AsyncioExecutor

async def main():
    rclpy.init(args=[])
    reported = []
    async with AsyncioExecutor(on_exception=lambda e, w: reported.append((e, w))) as executor:
        node = rclpy.create_node("tested")
        executor.add_node(node)
        got = []
        node.create_subscription(UInt64, "early", lambda m: got.append(m.data), 10)
        publisher = node.create_publisher(UInt64, "early", 10)
        await asyncio.sleep(0)
        limit = max(map(int, os.listdir("/proc/self/fd"))) + 1
        hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
        filled = []
        with suppress(OSError):
            while True:
                filled.append(os.open(os.devnull, os.O_RDONLY))
        timer = node.create_timer(0.001, lambda: got.append("timer"))
        async with asyncio.timeout(30):
            while not reported:
                await asyncio.sleep(0.001)
        executor.wake()
        await asyncio.sleep(0.05)
        assert len(reported) == 1, reported
        assert isinstance(reported[0][0], OSError), reported
        assert "Timer" in reported[0][1], reported
        publisher.publish(UInt64(data=4))
        while got != [4]:
            await asyncio.sleep(0.001)
    node.destroy_node()
    rclpy.shutdown()
    print("survived")

asyncio.run(main())
"""


def test_an_entity_that_gets_no_descriptor_is_reported_and_the_others_go_on(
    run_python: Callable[..., CompletedProcess[str]],
) -> None:
    ended = run_python(NO_FILES, timeout_s=DEADLINE_S)
    assert ended.stdout == "survived\n", ended.stderr


# Callbacks that raise.


@pytest.fixture
async def reported(context: Any, node: Node) -> Any:
    """What an executor that has the node reports, as (exception text, where)."""
    told: list[tuple[str, str]] = []
    async with AsyncioExecutor(
        context, on_exception=lambda error, where: told.append((str(error), where))
    ) as executor:
        executor.add_node(node)
        yield told


async def test_an_exception_in_any_callback_reaches_the_handler_and_the_next_one_runs(
    reported: list[tuple[str, str]],
    node: Node,
    peer: Peer,
    topic: str,
    until: Until,
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
        await until(lambda count=count: all(times(kind) >= count for kind in kinds[:-1]))
        await until(lambda: times("MATCHED"))
    assert {text for text, _ in reported} == {"no"}


async def test_without_a_handler_the_loops_own_is_told(
    context: Any, node: Node, until: Until
) -> None:
    told: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, report: told.append(report))

    def fail() -> None:
        raise ValueError("no")

    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        node.create_timer(0.005, fail)
        await until(lambda: len(told) >= 2)
    assert isinstance(told[0]["exception"], ValueError)
    assert "/tested: timer of 0.005 s" in told[0]["message"]


async def test_a_handler_that_raises_itself_is_reported_to_the_loop(
    context: Any, node: Node, until: Until
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
    reported: list[tuple[str, str]], node: Node, peer: Peer, topic: str, until: Until
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
    context: Any, node: Node, topic: str, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.ros.entities.RETRY_AFTER_FAILED_TAKE_S", 0.01)
    told: list[str] = []
    got: list[int] = []
    tapped: list[bytes] = []
    async with AsyncioExecutor(
        context, on_exception=lambda error, where: told.append(str(error))
    ) as executor:
        executor.add_node(node)
        typed = node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 10)
        tap = RawTap(lambda data, *_: tapped.append(data))
        raw = node.create_subscription(UInt64, topic, tap, 10, raw=True)
        await asyncio.sleep(0)
        sources: Any = executor._sources
        takers = {each: sources[each]._taker for each in (typed, raw)}

        def fail(*_: Any) -> None:
            raise rcl.RclCallFailed("cannot take")

        for each, taker in takers.items():
            sources[each]._taker = SimpleNamespace(take=fail, close=taker.close, info=taker.info)
        node.create_publisher(UInt64, topic, 10).publish(UInt64(data=3))
        await until(lambda: len(told) >= 4)
        assert got == tapped == []
        for each, taker in takers.items():
            sources[each]._taker = taker
        await until(lambda: got == [3] and len(tapped) == 1)
    assert set(told) == {"cannot take"}


# Callbacks that block.


def named_ms(caplog: pytest.LogCaptureFixture, whom: str) -> list[int]:
    """For how long it is said that a callback held the loop; others may do so on a busy machine."""
    found = (re.search(r"(.*) held the loop for (\d+) ms", text) for text in caplog.messages)
    return [int(each[2]) for each in found if each is not None and whom in each[1]]


@pytest.mark.parametrize("kind", ["subscription", "tap", "service", "timer", "guard", "task"])
async def test_a_callback_that_holds_the_loop_is_named_with_its_duration(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    caplog: pytest.LogCaptureFixture,
    kind: str,
) -> None:
    def hog(*arguments: Any) -> Any:
        time.sleep(0.06)
        return arguments[-1] if arguments else None

    match kind:
        case "subscription":
            node.create_subscription(UInt64, topic, hog, 10)
        case "tap":
            node.create_subscription(UInt64, topic, RawTap(hog), 10, raw=True)
        case "service":
            node.create_service(SetBool, topic, hog)
            node.create_client(SetBool, topic).call_async(SetBool.Request())
        case "timer":
            node.create_timer(0.1, hog)
        case "guard":
            node.create_guard_condition(hog).trigger()
        case "task":
            executor.create_task(hog)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: any(ms >= 60 for ms in named_ms(caplog, kind)))
    assert ("hog" in caplog.text) or kind == "tap"


async def test_a_callback_that_blocks_again_and_again_is_not_named_every_time(
    executor: AsyncioExecutor,
    node: Node,
    until: Until,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    called: list[int] = []

    def hog() -> None:
        called.append(1)
        time.sleep(0.06)

    node.create_timer(0.001, hog)
    await until(lambda: len(called) >= 3)
    assert len(named_ms(caplog, "hog")) == 1
    monkeypatch.setattr(executor._runtime.slow, "_quiet_until_ns", {})
    await until(lambda: len(named_ms(caplog, "hog")) == 2)
    assert "times since the last warning" in caplog.text


async def test_an_async_callback_that_blocks_between_two_awaits_is_named(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    caplog: pytest.LogCaptureFixture,
) -> None:
    took_ms: list[float] = []

    async def hog(message: UInt64) -> None:
        begun = time.monotonic()
        await asyncio.sleep(0.2)
        time.sleep(0.06)  # noqa: ASYNC251 - it is to block
        took_ms.append((time.monotonic() - begun) * 1e3)
        await asyncio.sleep(0)

    node.create_subscription(UInt64, topic, hog, 10)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: any(ms >= 60 for ms in named_ms(caplog, "hog")))
    assert max(named_ms(caplog, "hog")) < took_ms[0]  # the time that it waited does not count


# Entities destroyed with something pending.


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
        group = [
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
    await until(lambda: len(executor._sources) < 20)
