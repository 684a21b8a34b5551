"""Opening, closing and misusing an executor: nothing stays behind, and errors say what to do."""

from __future__ import annotations

import asyncio
import gc
import signal
import threading
import time
from collections.abc import Awaitable, Callable
from subprocess import CompletedProcess
from typing import Any

import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap
from robotctl.testing.descriptors import loop_descriptors
from robotctl.testing.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]
RunPython = Callable[..., CompletedProcess[str]]


def populate(node: Node, topic: str, on_message: Callable[[Any], object]) -> Any:
    """One of each kind on the node; returns the publisher of the topic."""
    node.create_subscription(UInt64, topic, on_message, 100)
    node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 100, raw=True)
    node.create_service(SetBool, topic, lambda request, response: response)
    node.create_client(SetBool, topic)
    node.create_timer(0.001, lambda: None)
    node.create_guard_condition(lambda: None)
    return node.create_publisher(UInt64, topic, 100)


class SlowToEnd:
    """An async callback that waits for ever, and cleans up when it is cancelled."""

    def __init__(self) -> None:
        self.events: list[str] = []

    async def __call__(self, message: UInt64) -> None:
        self.events.append("running")
        try:
            await asyncio.sleep(DEADLINE_S)
        finally:
            await asyncio.sleep(0.02)
            self.events.append("cleaned up")


# Shutdown.


async def test_serve_ends_when_a_callback_shuts_down_and_no_callback_runs_after_it(
    context: Any, node: Node, topic: str
) -> None:
    got: list[int] = []

    def on_message(message: UInt64) -> None:
        got.append(message.data)
        executor.shutdown()

    publisher = populate(node, topic, on_message)
    executor = AsyncioExecutor(context)
    async with asyncio.timeout(DEADLINE_S), executor:
        executor.add_node(node)
        await asyncio.sleep(0.01)  # Attached, and idle.
        for value in range(10):
            publisher.publish(UInt64(data=value))
        await executor.serve()
        await asyncio.sleep(0.02)
    assert got == [0]
    assert node.executor is None


async def test_shutdown_from_an_async_callback_lets_it_run_to_its_next_await(
    context: Any, node: Node, topic: str
) -> None:
    done: list[bool] = []

    async def on_message(message: UInt64) -> None:
        await asyncio.sleep(0.001)
        executor.shutdown()
        done.append(True)
        await asyncio.sleep(DEADLINE_S)
        done.append(False)

    publisher = populate(node, topic, on_message)
    executor = AsyncioExecutor(context)
    async with asyncio.timeout(DEADLINE_S), executor:
        executor.add_node(node)
        publisher.publish(UInt64())
        await executor.serve()
    assert done == [True]


async def test_shutdown_from_another_thread_waits_for_running_callbacks(
    context: Any, node: Node, topic: str, until: Until
) -> None:
    slow = SlowToEnd()
    publisher = populate(node, topic, slow)
    async with asyncio.timeout(DEADLINE_S), AsyncioExecutor(context) as executor:
        executor.add_node(node)
        publisher.publish(UInt64())
        await until(lambda: slow.events == ["running"])
        assert await asyncio.to_thread(executor.shutdown, 0.0) is False
        assert await asyncio.to_thread(executor.shutdown) is True
        assert slow.events == ["running", "cleaned up"]
        await executor.serve()


async def test_leaving_the_block_cancels_async_callbacks_and_waits_for_their_cleanup(
    context: Any, node: Node, topic: str, until: Until
) -> None:
    slow = SlowToEnd()
    publisher = populate(node, topic, slow)
    async with AsyncioExecutor(context) as executor:
        executor.add_node(node)
        publisher.publish(UInt64())
        await until(lambda: slow.events)
    assert slow.events == ["running", "cleaned up"]


async def test_a_call_that_waits_when_the_executor_shuts_down_is_told(
    context: Any, node: Node, topic: str
) -> None:
    async with asyncio.timeout(DEADLINE_S), AsyncioExecutor(context) as executor:
        executor.add_node(node)
        client = node.create_client(SetBool, topic)
        call = asyncio.create_task(executor.call(client, SetBool.Request(), timeout_s=None))
        plain = client.call_async(SetBool.Request())
        await asyncio.sleep(0.01)
        executor.shutdown()
        with pytest.raises(ShutdownException, match="shut down while a call waited"):
            await call
        assert isinstance(plain.exception(), ShutdownException)


async def test_a_call_whose_client_is_destroyed_is_told(
    executor: AsyncioExecutor, node: Node, topic: str
) -> None:
    client = node.create_client(SetBool, topic)
    call = asyncio.create_task(executor.call(client, SetBool.Request(), timeout_s=None))
    await asyncio.sleep(0.01)
    node.destroy_client(client)
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
        "robotctl.ros.executor.get_current_signal_handlers_options",
        lambda: SignalHandlerOptions.ALL,
    )
    context = new_context()
    async with asyncio.timeout(DEADLINE_S), AsyncioExecutor(context) as executor:
        signals: Any = executor._wait_set._signals
        signals.trigger()
        await asyncio.sleep(0.05)
        assert not executor._is_shutdown
        with context.handle:
            context.handle.shutdown()
        await executor.serve()


async def test_200_starts_and_stops_under_traffic_leave_nothing_behind(
    context: Any, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    publisher = populate(node, topic, lambda message: got.append(message.data))
    stop = threading.Event()

    def publish() -> None:
        while not stop.is_set():
            publisher.publish(UInt64())
            time.sleep(0.0002)

    async def cycle() -> None:
        count = len(got)
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            await until(lambda: len(got) > count)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        await cycle()
        gc.collect()
        before = (loop_descriptors(), threading.active_count())
        for _ in range(200):
            await cycle()
        gc.collect()
        assert (loop_descriptors(), threading.active_count()) == before
    finally:
        stop.set()
        thread.join()


CYCLES = """
import asyncio, gc, os, resource, sys, threading
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool
from robotctl.ros import AsyncioExecutor, RawTap, Ticker

cycles = int(sys.argv[1])

async def cycle():
    context = Context()
    context.init(args=[])
    got = asyncio.Event()
    async with AsyncioExecutor(context) as executor:
        node = Node("tested", context=context)
        executor.add_node(node)
        node.create_subscription(UInt64, "flood", lambda _: got.set(), 100)
        node.create_subscription(UInt64, "flood", RawTap(lambda *_: got.set()), 100, raw=True)
        node.create_service(SetBool, "served", lambda request, response: response)
        client = node.create_client(SetBool, "served")
        node.create_guard_condition(lambda: None).trigger()
        publisher = node.create_publisher(UInt64, "flood", 100)
        node.create_timer(0.0005, lambda: publisher.publish(UInt64()))
        async with asyncio.timeout(30):
            await got.wait()
            async for _ in Ticker(1000.0):
                break
            await executor.call(client, SetBool.Request(), timeout_s=30)
        executor.create_task(executor.call, client, SetBool.Request(), timeout_s=30)
    node.destroy_node()
    context.shutdown()
    context.destroy()

def state():
    gc.collect()
    with open("/proc/self/statm") as statm:
        resident = int(statm.read().split()[1]) * resource.getpagesize()
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task")), resident

async def main():
    for _ in range(20):
        await cycle()
    before = state()
    for _ in range(cycles):
        await cycle()
    after = state()
    print(*before, *after)

asyncio.run(main())
"""


def test_200_lives_of_a_whole_context_leave_files_threads_and_memory_as_they_were(
    run_python: RunPython,
) -> None:
    ended = run_python(CYCLES, 200, timeout_s=600)
    assert ended.returncode == 0, ended.stderr
    files, threads, memory, files_after, threads_after, memory_after = map(
        int, ended.stdout.split()
    )
    assert (files_after, threads_after) == (files, threads)
    # rclpy's own contexts leave something; 200 of them must not be 50 kB each.
    assert memory_after - memory < 10_000_000


# Cancellation.


@pytest.mark.parametrize("turns", range(8))
async def test_opening_may_be_cancelled_at_any_await(
    context: Any, node: Node, turns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.ros.proof._proven", False)
    populate(node, f"/cancelled_{turns}", lambda _: None)
    before = loop_descriptors()
    executor = AsyncioExecutor(context)

    async def live() -> None:
        async with executor:
            executor.add_node(node)
            await executor.serve()

    task = asyncio.create_task(live())
    for _ in range(turns):
        await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert loop_descriptors() == before
    async with AsyncioExecutor(context) as second:
        assert second.add_node(node)


async def test_cancelling_a_call_makes_the_client_forget_it(
    executor: AsyncioExecutor, node: Node, topic: str
) -> None:
    client = node.create_client(SetBool, topic)
    for turns in range(4):
        call = asyncio.create_task(executor.call(client, SetBool.Request(), timeout_s=None))
        for _ in range(turns):
            await asyncio.sleep(0)
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        assert client._pending_requests == {}


async def test_cancelling_the_waits_leaves_the_executor_working(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    client = node.create_client(SetBool, topic)
    future = Future()
    for waiting in (
        executor.serve(),
        executor.wait_for_service(client, timeout_s=None),
        executor.wait_for(future, timeout_s=None),
    ):
        task = asyncio.create_task(waiting)
        await asyncio.sleep(0.01)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    assert future.cancelled()
    got: list[int] = []
    node.create_timer(0.001, lambda: got.append(1))
    await until(lambda: got)


async def test_an_awaited_rclpy_future_is_cancelled_with_its_task(
    executor: AsyncioExecutor,
) -> None:
    future = Future()

    async def wait() -> None:
        await future

    task = asyncio.create_task(wait())
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert future.cancelled()


# Tasks.


async def test_create_task_runs_functions_coroutines_and_coroutine_functions_from_any_thread(
    executor: AsyncioExecutor,
) -> None:
    loop = asyncio.get_running_loop()

    def plain(value: int) -> tuple[int, bool]:
        return value, asyncio.get_running_loop() is loop

    async def slow(value: int) -> tuple[int, bool]:
        await asyncio.sleep(0.001)
        return plain(value)

    async with asyncio.timeout(DEADLINE_S):
        assert await executor.create_task(plain, 1) == (1, True)
        assert await executor.create_task(slow, value=2) == (2, True)
        assert await executor.create_task(slow(3)) == (3, True)
        future = await asyncio.to_thread(executor.create_task, slow, 4)
        assert await future == (4, True)


async def test_tasks_created_before_the_executor_opens_run_when_it_opens(context: Any) -> None:
    executor = AsyncioExecutor(context)
    future = executor.create_task(lambda: 5)
    async with asyncio.timeout(DEADLINE_S), executor:
        assert await future == 5


async def test_an_exception_of_a_task_goes_to_its_listener_or_else_to_the_handler(
    context: Any, until: Until
) -> None:
    reported: list[tuple[str, str]] = []

    async def fail() -> None:
        raise ValueError("no")

    async with AsyncioExecutor(
        context, on_exception=lambda error, where: reported.append((str(error), where))
    ) as executor:
        heard: list[Future] = []
        executor.create_task(fail).add_done_callback(heard.append)
        await until(lambda: heard)
        assert isinstance(heard[0].exception(), ValueError)
        assert reported == []
        executor.create_task(fail)
        await until(lambda: reported)
    assert reported[0][0] == "no"
    assert "fail" in reported[0][1]


async def test_cancelling_a_task_cancels_its_coroutine(
    executor: AsyncioExecutor, until: Until
) -> None:
    events: list[str] = []

    async def work() -> None:
        events.append("running")
        try:
            await asyncio.sleep(DEADLINE_S)
        except asyncio.CancelledError:
            events.append("cancelled")
            raise

    task = executor.create_task(work)
    await until(lambda: events)
    task.cancel()
    await until(lambda: events == ["running", "cancelled"])
    assert task.cancelled()


# Wrong use.


async def test_a_node_added_twice_answers_false(executor: AsyncioExecutor, node: Node) -> None:
    assert executor.add_node(node) is False
    assert executor.get_nodes() == [node]
    assert node.executor is executor


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
    assert executor._sources == {}
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
    assert not [source for source in executor._sources.values() if "short_lived" in source.where]


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


# The bridge from rclpy's futures.


async def test_rclpy_futures_await_as_before_once_no_executor_is_open(context: Any) -> None:
    before = Future.__await__
    async with AsyncioExecutor(context), AsyncioExecutor(context):
        assert Future.__await__ is not before
    assert Future.__await__ is before


async def test_a_future_resolved_by_another_thread_wakes_the_loop(
    executor: AsyncioExecutor,
) -> None:
    future = Future()
    begun = time.monotonic()
    threading.Timer(0.02, future.set_result, [7]).start()
    async with asyncio.timeout(DEADLINE_S):
        assert await future == 7
    # Not because the deadline woke the loop.
    assert time.monotonic() - begun < DEADLINE_S / 2
    failing = Future()
    threading.Timer(0.02, failing.set_exception, [ValueError("no")]).start()
    with pytest.raises(ValueError, match="no"):
        await executor.wait_for(failing, timeout_s=DEADLINE_S)
    with pytest.raises(TimeoutError):
        await executor.wait_for(Future(), timeout_s=0.01)


# Churn.


async def test_churn_of_subscriptions_under_traffic_loses_no_message_of_the_others(
    executor: AsyncioExecutor, node: Node, topic: str, until: Until
) -> None:
    got: list[int] = []
    node.create_subscription(UInt64, topic, lambda m: got.append(m.data), 10_000)
    publisher = node.create_publisher(UInt64, topic, 10_000)
    sent = 0

    def publish() -> None:
        nonlocal sent
        publisher.publish(UInt64(data=sent))
        sent += 1

    node.create_timer(0.0005, publish, callback_group=ReentrantCallbackGroup())
    before = None
    for round_number in range(60):
        batch = [
            node.create_subscription(UInt64, topic, lambda _: None, 10),
            node.create_subscription(UInt64, topic, RawTap(lambda *_: None), 10, raw=True),
        ]
        seen = len(got)
        await until(lambda seen=seen: len(got) > seen)
        for subscription in batch:
            node.destroy_subscription(subscription)
        if round_number == 5:
            await asyncio.sleep(0)
            before = loop_descriptors()
    await asyncio.sleep(0)
    assert loop_descriptors() == before
    count = sent
    await until(lambda: len(got) >= count)
    assert got == list(range(len(got)))
