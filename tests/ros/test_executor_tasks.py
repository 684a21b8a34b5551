"""Tasks, awaited calls, and their cancellation."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor
from tests.ros.open_executor import Bench, loop_descriptors, populate
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until

# Cancellation.


@pytest.mark.parametrize("turns", range(8))
async def test_opening_may_be_cancelled_at_any_await(
    context: Any, node: Node, turns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.ros.executor.announcements._passed", False)
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


async def test_cancelling_a_call_makes_the_client_forget_it(bench: Bench) -> None:
    client = bench.create_client(SetBool, bench.topic)
    for turns in range(4):
        call = asyncio.create_task(bench.opened.call(client, SetBool.Request(), timeout_s=None))
        for _ in range(turns):
            await asyncio.sleep(0)
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        assert client._pending_requests == {}


async def test_cancelling_the_waits_leaves_the_executor_working(bench: Bench) -> None:
    client = bench.create_client(SetBool, bench.topic)
    future = Future()
    for waiting in (
        bench.opened.serve(),
        bench.opened.wait_for_service(client, timeout_s=None),
        bench.opened.wait_for(future, timeout_s=None),
    ):
        task = asyncio.create_task(waiting)
        await asyncio.sleep(0.01)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    assert future.cancelled()
    got = bench.ticks(0.001)
    await until(lambda: got)


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
    context: Any,
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


async def test_cancelling_a_task_cancels_its_coroutine(executor: AsyncioExecutor) -> None:
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


async def test_no_task_is_lost_that_another_thread_creates_while_the_executor_opens(
    context: Any,
) -> None:
    ran: list[int] = []
    created = 0
    stop = threading.Event()

    def create() -> None:
        nonlocal created
        while not stop.is_set():
            executor.create_task(ran.append, created)
            created += 1

    executor = AsyncioExecutor(context)
    thread = threading.Thread(target=create)
    thread.start()
    await until(lambda: created)
    async with executor:
        await until(lambda: ran)
        stop.set()
        await asyncio.to_thread(thread.join)
        await until(lambda: len(ran) == created)
    assert ran == list(range(created))


def test_what_a_listener_of_a_task_that_never_began_raises_is_said(
    context: Any, caplog: pytest.LogCaptureFixture
) -> None:
    def listen(task: Future) -> None:
        raise ValueError("no")

    executor = AsyncioExecutor(context)
    executor.create_task(print).add_done_callback(listen)
    executor.shutdown()
    assert "exception in the done callback of a future" in caplog.text


# Awaiting rclpy's futures.


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


def test_a_task_may_be_cancelled_after_its_loop_has_gone(context: Any) -> None:
    tasks: list[Future] = []

    async def live() -> None:
        async with AsyncioExecutor(context) as executor:
            tasks.append(executor.create_task(asyncio.sleep, 0))
            tasks.append(executor.create_task(asyncio.sleep, DEADLINE_S))
            await tasks[0]

    asyncio.run(live())
    for task in tasks:
        task.cancel()
    assert [task.cancelled() for task in tasks] == [False, True]
