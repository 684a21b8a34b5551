"""How the executor's own loop polls: its waits, what a descriptor says, and watchers that end."""

from __future__ import annotations

import asyncio
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import pytest

from robotctl.ros.executor import EventLoop, run
from robotctl.ros.executor.event_loop import unwatch, watch
from tests.support.waiting import DEADLINE_S


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


def in_time(main: Callable[[], Any], run_it: Callable[[Any], Any] = run) -> Any:
    """Run a coroutine function with a deadline."""

    async def limited() -> Any:
        async with asyncio.timeout(DEADLINE_S):
            return await main()

    return run_it(limited())


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
