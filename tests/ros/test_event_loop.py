"""The executor's own loop: what it calls while it polls, and what it keeps of asyncio."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import partial
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from std_msgs.msg import String

from robotctl.ros.executor import AsyncioExecutor, EventLoop, Ticker, run
from robotctl.ros.executor.event_loop import unwatch, watch
from tests.support.waiting import DEADLINE_S

LABEL: ContextVar[str] = ContextVar("LABEL", default="none")


@pytest.fixture
def eventfd() -> Iterator[int]:
    """An eventfd that is readable once it is written to."""
    descriptor = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
    yield descriptor
    os.close(descriptor)


def in_time(main: Callable[[], Any]) -> Any:
    """Run a coroutine function in an EventLoop, with a deadline."""

    async def limited() -> Any:
        async with asyncio.timeout(DEADLINE_S):
            return await main()

    return run(limited())


@pytest.mark.parametrize("run_it", [run, asyncio.run])
def test_a_watcher_is_called_in_any_loop_in_the_context_of_its_watch(
    run_it: Callable[[Any], Any], eventfd: int
) -> None:
    async def main() -> str:
        loop = asyncio.get_running_loop()
        called: asyncio.Future[str] = loop.create_future()

        def on_readable() -> None:
            os.eventfd_read(eventfd)
            assert asyncio.get_running_loop() is loop
            called.set_result(LABEL.get())

        LABEL.set("of the watch")
        watch(loop, eventfd, on_readable)
        LABEL.set("later")
        os.eventfd_write(eventfd, 1)
        async with asyncio.timeout(DEADLINE_S):
            found = await called
        unwatch(loop, eventfd)
        return found

    assert run_it(main()) == "of the watch"


def test_what_a_watcher_schedules_does_not_wait_for_the_next_event(eventfd: int) -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        called, fired = asyncio.Event(), asyncio.Event()

        def on_readable() -> None:
            os.eventfd_read(eventfd)
            loop.call_soon(called.set)
            loop.call_later(0.001, fired.set)

        watch(loop, eventfd, on_readable)
        threading.Timer(0.02, os.eventfd_write, (eventfd, 1)).start()
        await called.wait()
        await fired.wait()
        unwatch(loop, eventfd)

    in_time(main)


@pytest.mark.parametrize("kind", [ValueError, asyncio.CancelledError])
def test_an_exception_of_a_watcher_goes_to_the_handler_and_the_others_are_called(
    kind: type[BaseException], eventfd: int
) -> None:
    told: list[object] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: told.append(context["exception"]))
        ours, theirs = socket.socketpair()
        other = os.eventfd(1, os.EFD_NONBLOCK)
        called = asyncio.Event()

        def fail() -> None:
            os.eventfd_read(eventfd)
            raise kind("the watcher is broken")

        os.eventfd_write(eventfd, 1)
        watch(loop, eventfd, fail)
        watch(loop, other, called.set)
        ours.setblocking(False)
        theirs.send(b"beside")
        assert await loop.sock_recv(ours, 16) == b"beside"
        await called.wait()
        for each in (eventfd, other):
            unwatch(loop, each)
        os.close(other)
        ours.close()
        theirs.close()

    in_time(main)
    assert [str(error) for error in told] == ["the watcher is broken"]


def test_a_socket_is_heard_at_once_beside_many_watchers_that_stay_ready() -> None:
    calls = 0

    async def main() -> int:
        loop = asyncio.get_running_loop()
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        flooded = [os.eventfd(1, os.EFD_NONBLOCK) for _ in range(20)]

        def leave_it_ready() -> None:
            nonlocal calls
            calls += 1

        for each in flooded:
            watch(loop, each, leave_it_ready)
        await asyncio.sleep(0)
        receiving = asyncio.create_task(loop.sock_recv(ours, 16))
        await asyncio.sleep(0)
        theirs.send(b"stop")
        before = calls
        assert await receiving == b"stop"
        turns = (calls - before) // len(flooded)
        for each in flooded:
            unwatch(loop, each)
            os.close(each)
        ours.close()
        theirs.close()
        return turns

    assert in_time(main) <= 3


def test_a_watcher_may_end_another_one_that_is_ready_in_the_same_turn(eventfd: int) -> None:
    calls: list[int] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        other = os.eventfd(0, os.EFD_NONBLOCK)

        def first_ends_the_other(own: int, another: int) -> None:
            calls.append(own)
            unwatch(loop, own)
            unwatch(loop, another)

        for own, another in ((eventfd, other), (other, eventfd)):
            os.eventfd_write(own, 1)
            watch(loop, own, partial(first_ends_the_other, own, another))
        for _ in range(3):
            await asyncio.sleep(0)
        os.close(other)

    in_time(main)
    assert len(calls) == 1


def test_an_interrupt_cancels_the_coroutine_as_in_asyncio_run(eventfd: int) -> None:
    async def main() -> None:
        watch(asyncio.get_running_loop(), eventfd, lambda: None)
        threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGINT)).start()
        await asyncio.sleep(DEADLINE_S)

    with pytest.raises(KeyboardInterrupt):
        in_time(main)


def test_messages_timers_and_ticks_come_in_the_loop_of_the_executor(
    new_context: Callable[[], Context],
) -> None:
    context = new_context()
    heard: list[str] = []

    def hear(said: String) -> None:
        heard.append(said.data)

    async def main() -> int:
        assert isinstance(asyncio.get_running_loop(), EventLoop)
        node = rclpy.create_node("in_event_loop", context=context)
        node.create_subscription(String, "said", hear, 10)
        publisher = node.create_publisher(String, "said", 10)
        ticks = 0
        async with AsyncioExecutor(context) as executor, Ticker(200.0) as ticker:
            executor.add_node(node)
            node.create_timer(0.01, lambda: publisher.publish(String(data="hello")))
            while len(heard) < 3:
                await anext(ticker)
                ticks += 1
        node.destroy_node()
        return ticks

    assert in_time(main) >= 1
    assert set(heard) == {"hello"}
