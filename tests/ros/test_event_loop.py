"""The executor's own loop: how it polls, what it calls meanwhile, and what it keeps of asyncio."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
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
def eventfds() -> Iterator[Callable[[], int]]:
    """Make eventfds that are ready, and stay so until they are read."""
    made: list[int] = []

    def make() -> int:
        made.append(os.eventfd(1, os.EFD_NONBLOCK | os.EFD_CLOEXEC))
        return made[-1]

    yield make
    for each in made:
        os.close(each)


@pytest.fixture
def eventfd(eventfds: Callable[[], int]) -> int:
    """An eventfd that is readable once it is written to."""
    os.eventfd_read(descriptor := eventfds())
    return descriptor


def in_time(main: Callable[[], Any], run_it: Callable[[Any], Any] = run) -> Any:
    """Run a coroutine function with a deadline."""

    async def limited() -> Any:
        async with asyncio.timeout(DEADLINE_S):
            return await main()

    return run_it(limited())


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
    kind: type[BaseException], eventfds: Callable[[], int]
) -> None:
    told: list[object] = []

    async def main() -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: told.append(context["exception"]))
        ours, theirs = socket.socketpair()
        failing, other, called = eventfds(), eventfds(), asyncio.Event()

        def fail() -> None:
            os.eventfd_read(failing)
            raise kind("the watcher is broken")

        watch(loop, failing, fail)
        watch(loop, other, called.set)
        ours.setblocking(False)
        with ours, theirs:
            theirs.send(b"beside")
            assert await loop.sock_recv(ours, 16) == b"beside"
        await called.wait()
        for each in (failing, other):
            unwatch(loop, each)

    in_time(main)
    assert [str(error) for error in told] == ["the watcher is broken"]


def test_a_socket_is_heard_at_once_beside_many_watchers_that_stay_ready(
    eventfds: Callable[[], int],
) -> None:
    calls = 0

    async def main() -> int:
        loop = asyncio.get_running_loop()
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        flooded = [eventfds() for _ in range(20)]

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
        ours.close()
        theirs.close()
        return turns

    assert in_time(main) <= 3


def test_a_watcher_may_end_another_one_that_is_ready_in_the_same_turn(
    eventfds: Callable[[], int],
) -> None:
    calls: list[int] = []

    async def main() -> None:
        loop, one, other = asyncio.get_running_loop(), eventfds(), eventfds()

        def first_ends_the_other(own: int, another: int) -> None:
            calls.append(own)
            unwatch(loop, own)
            unwatch(loop, another)

        for own, another in ((one, other), (other, one)):
            watch(loop, own, partial(first_ends_the_other, own, another))
        for _ in range(3):
            await asyncio.sleep(0)

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


class CountingLoop(EventLoop):
    """A loop that counts its turns."""

    turns = 0

    def _run_once(self) -> None:
        self.turns += 1
        super()._run_once()  # type: ignore[misc]


async def _for_a_timer() -> None:
    await asyncio.sleep(0.0205)  # half a millisecond, for which epoll cannot wait, is left


async def _for_a_thread() -> None:
    woken = asyncio.Event()
    wake = partial(asyncio.get_running_loop().call_soon_threadsafe, woken.set)
    threading.Timer(0.02, wake).start()
    await woken.wait()


@pytest.mark.parametrize("wait", [_for_a_timer, _for_a_thread])
def test_the_loop_sleeps_while_it_waits(wait: Callable[[], Any]) -> None:
    with asyncio.Runner(loop_factory=CountingLoop) as runner:
        loop = runner.get_loop()
        assert isinstance(loop, CountingLoop)
        runner.run(wait())
        assert loop.turns < 10


def test_more_descriptors_than_one_turn_takes_are_all_heard(eventfds: Callable[[], int]) -> None:
    heard: set[int] = set()

    async def main() -> None:
        loop = asyncio.get_running_loop()
        for each in [eventfds() for _ in range(150)]:
            watch(loop, each, partial(heard.add, each))
        for _ in range(5):
            await asyncio.sleep(0)

    in_time(main)
    assert len(heard) == 150


@pytest.mark.parametrize("kind", [SystemExit, KeyboardInterrupt])
def test_what_ends_the_process_ends_the_loop(
    kind: type[BaseException], eventfds: Callable[[], int]
) -> None:
    async def main() -> None:
        loop, told = asyncio.get_running_loop(), asyncio.Event()
        loop.set_exception_handler(lambda *_: told.set())

        def fail() -> None:
            raise kind

        watch(loop, eventfds(), fail)
        await told.wait()

    with pytest.raises(kind):
        in_time(main)


def test_a_closed_pipe_is_heard_by_its_reader_and_its_full_writer() -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        hung_up, broken = asyncio.Event(), asyncio.Event()
        reading, closed = os.pipe()
        loop.add_reader(reading, hung_up.set)
        os.close(closed)
        await hung_up.wait()
        loop.remove_reader(reading)
        closed, writing = os.pipe2(os.O_NONBLOCK)
        with suppress(BlockingIOError):
            while os.write(writing, bytes(4096)):
                pass
        loop.add_writer(writing, broken.set)
        os.close(closed)
        await broken.wait()
        loop.remove_writer(writing)
        os.close(reading)
        os.close(writing)

    in_time(main)


@pytest.mark.parametrize("run_it", [run, asyncio.run])
def test_a_watch_that_ended_calls_nothing_and_can_begin_again(
    run_it: Callable[[Any], Any], eventfds: Callable[[], int]
) -> None:
    called: list[str] = []

    async def main() -> None:
        loop, heard, fd = asyncio.get_running_loop(), asyncio.Event(), eventfds()
        unwatch(loop, fd)  # not watched yet
        watch(loop, fd, partial(called.append, "after its end"))
        unwatch(loop, fd)
        for _ in range(3):
            await asyncio.sleep(0)
        watch(loop, fd, heard.set)
        await heard.wait()
        unwatch(loop, fd)

    in_time(main, run_it)
    assert called == []


@pytest.mark.parametrize("run_it", [run, asyncio.run])
def test_a_closed_loop_watches_nothing_any_more(run_it: Callable[[Any], Any]) -> None:
    async def main() -> asyncio.AbstractEventLoop:
        loop = asyncio.get_running_loop()
        watch(loop, ours.fileno(), lambda: None)
        return loop

    ours, theirs = socket.socketpair()
    with ours, theirs:
        unwatch(in_time(main, run_it), ours.fileno())


def test_a_watcher_may_replace_a_reader_that_is_ready_in_the_same_turn(
    eventfds: Callable[[], int],
) -> None:
    called: list[str] = []

    async def main() -> None:
        loop, heard = asyncio.get_running_loop(), asyncio.Event()
        ready, watched = eventfds(), eventfds()

        def replace() -> None:
            unwatch(loop, watched)
            loop.remove_reader(ready)
            loop.add_reader(ready, heard.set)

        loop.add_reader(ready, called.append, "the reader of before")
        watch(loop, watched, replace)
        await heard.wait()
        loop.remove_reader(ready)

    in_time(main)
    assert called == []
