"""However an executor is ended, callbacks end in order, and pending calls fail."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Callable
from typing import Any

import pytest
from rclpy.executors import ShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor
from tests.ros.conftest import RunPython
from tests.ros.open_executor import Bench, engine_of, loop_descriptors, opened, populate
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until


class SlowToEnd:
    """An async callback that waits forever, and cleans up when it is cancelled."""

    def __init__(self) -> None:
        self.events: list[str] = []

    async def __call__(self, message: UInt64) -> None:
        self.events.append("running")
        try:
            await asyncio.sleep(DEADLINE_S)
        finally:
            await asyncio.sleep(0.02)
            self.events.append("cleaned up")


async def test_serve_ends_when_a_callback_shuts_down_and_no_callback_runs_after_it(
    node: Bench,
) -> None:
    got: list[int] = []

    def on_message(message: UInt64) -> None:
        got.append(message.data)
        executor.shutdown()

    publisher = populate(node, node.topic, on_message)
    async with opened(node) as executor:
        await asyncio.sleep(0.01)  # Attached, and idle.
        for value in range(10):
            publisher.publish(UInt64(data=value))
        await executor.serve()
        await asyncio.sleep(0.02)
    assert got == [0]
    assert node.executor is None


async def test_shutdown_from_an_async_callback_lets_it_run_to_its_next_await(node: Bench) -> None:
    done: list[bool] = []

    async def on_message(message: UInt64) -> None:
        await asyncio.sleep(0.001)
        executor.shutdown()
        done.append(True)
        await asyncio.sleep(DEADLINE_S)
        done.append(False)

    publisher = populate(node, node.topic, on_message)
    async with opened(node) as executor:
        publisher.publish(UInt64())
        await executor.serve()
    assert done == [True]


async def test_shutdown_from_another_thread_waits_for_running_callbacks(node: Bench) -> None:
    slow = SlowToEnd()
    publisher = populate(node, node.topic, slow)
    async with opened(node) as executor:
        publisher.publish(UInt64())
        await until(lambda: slow.events == ["running"])
        assert await asyncio.to_thread(executor.shutdown, 0.0) is False
        assert await asyncio.to_thread(executor.shutdown) is True
        assert slow.events == ["running", "cleaned up"]
        await executor.serve()


async def test_leaving_the_block_cancels_async_callbacks_and_waits_for_their_cleanup(
    node: Bench,
) -> None:
    slow = SlowToEnd()
    publisher = populate(node, node.topic, slow)
    async with opened(node):
        publisher.publish(UInt64())
        await until(lambda: slow.events)
    assert slow.events == ["running", "cleaned up"]


async def test_an_executor_that_is_shut_down_while_it_opens_lets_go_of_everything(
    context: Any, node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.ros.executor.announcements._passed", False)
    before = (loop_descriptors(), threading.active_count(), Future.__await__)
    executor = AsyncioExecutor(context)
    executor.add_node(node)
    never_begun = executor.create_task(lambda: None)
    opening = asyncio.create_task(executor.__aenter__())
    await asyncio.sleep(0)
    assert executor.shutdown() is True
    with pytest.raises(RuntimeError, match="was shut down; create a new one"):
        await opening
    assert (loop_descriptors(), threading.active_count(), Future.__await__) == before
    assert node.executor is None
    assert never_begun.cancelled()


async def test_a_call_that_waits_when_the_executor_shuts_down_is_told(node: Bench) -> None:
    async with opened(node) as executor:
        client = node.create_client(SetBool, node.topic)
        call = asyncio.create_task(executor.call(client, SetBool.Request(), timeout_s=None))
        plain = client.call_async(SetBool.Request())
        await asyncio.sleep(0.01)
        executor.shutdown()
        with pytest.raises(ShutdownException, match="shut down while a call waited"):
            await call
        assert isinstance(plain.exception(), ShutdownException)


async def test_a_call_whose_client_is_destroyed_is_told(bench: Bench) -> None:
    client = bench.create_client(SetBool, bench.topic)
    call = asyncio.create_task(bench.opened.call(client, SetBool.Request(), timeout_s=None))
    await asyncio.sleep(0.01)
    bench.destroy_client(client)
    async with asyncio.timeout(DEADLINE_S):
        with pytest.raises(ShutdownException, match="destroyed while a call waited"):
            await call


async def test_serve_ends_when_the_context_is_shut_down_by_another_thread(
    new_context: Callable[[], Any], topic: str
) -> None:
    context = new_context()
    node = Node("tested", context=context)
    populate(node, topic, lambda _: None)
    async with asyncio.timeout(DEADLINE_S), AsyncioExecutor(context) as executor:
        executor.add_node(node)
        threading.Timer(0.05, context.shutdown).start()
        await executor.serve()
    node.destroy_node()


SERVE_UNTIL_SIGNAL = """
import asyncio, os, signal, sys, rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from robotctl.ros import AsyncioExecutor

how, number = sys.argv[1], int(sys.argv[2])

async def main():
    loop = asyncio.get_running_loop()
    options = SignalHandlerOptions.ALL if how == "rclpy" else SignalHandlerOptions.NO
    rclpy.init(args=[], signal_handler_options=options)
    node = rclpy.create_node("tested")
    node.create_guard_condition(lambda: None)
    async with AsyncioExecutor() as executor:
        executor.add_node(node)
        node.create_timer(0.001, lambda: None)
        if how == "loop":
            loop.add_signal_handler(number, executor.shutdown)
        elif how == "plain":
            signal.signal(number, lambda *_: executor.shutdown())
        loop.call_later(0.1, os.kill, os.getpid(), number)
        await executor.serve()
    print("served")
    node.destroy_node()
    rclpy.try_shutdown()

try:
    asyncio.run(main())
except KeyboardInterrupt:
    print("interrupted")
"""


@pytest.mark.parametrize(
    ("how", "number", "said"),
    [
        ("loop", signal.SIGTERM, "served\n"),
        ("plain", signal.SIGTERM, "served\n"),
        ("rclpy", signal.SIGTERM, "served\n"),
        ("python", signal.SIGINT, "interrupted\n"),
    ],
)
def test_a_signal_ends_serve_whoever_handles_it(
    run_python: RunPython, how: str, number: int, said: str
) -> None:
    ended = run_python(SERVE_UNTIL_SIGNAL, how, int(number), timeout_s=DEADLINE_S)
    assert (ended.returncode, ended.stdout) == (0, said), ended.stderr


async def test_a_shutdown_that_follows_its_signal_with_a_delay_is_noticed(
    new_context: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # As rclpy's own handler of SIGTERM does it: wake the executors, then shut the context down
    # in C++, where no callback tells Python.
    monkeypatch.setattr(
        "robotctl.ros.executor.engine.get_current_signal_handlers_options",
        lambda: SignalHandlerOptions.ALL,
    )
    context = new_context()
    async with asyncio.timeout(DEADLINE_S), AsyncioExecutor(context) as executor:
        wait_set: Any = engine_of(executor)._wait_set
        wait_set._signals.trigger()
        await asyncio.sleep(0.05)
        assert not executor._is_shutdown
        with context.handle:
            context.handle.shutdown()
        await executor.serve()
