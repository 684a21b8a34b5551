"""A deadline acts as `asyncio.timeout` does, and one timer serves all work; on a virtual clock."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from robotctl.ipc.request_handler import Deadline, DeadlineMissed


class VirtualSelector(selectors.DefaultSelector):
    """A selector that does not wait: the clock of its loop jumps to the next timer."""

    now_s = 0.0

    def select(self, timeout: float | None = None) -> list[Any]:
        self.now_s += timeout or 0.0
        return super().select(0.0)


class VirtualLoop(asyncio.SelectorEventLoop):
    """A loop on the clock of its selector."""

    def __init__(self) -> None:
        self.clock = VirtualSelector()
        super().__init__(self.clock)
        self.timers = 0

    def time(self) -> float:
        return self.clock.now_s

    def call_at(self, *args: Any, **options: Any) -> asyncio.TimerHandle:  # type: ignore[override]
        self.timers += 1
        return super().call_at(*args, **options)


def run(work: Callable[[VirtualLoop, Deadline], Awaitable[None]]) -> None:
    async def main() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        await work(loop, Deadline())

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main())


async def wait_too_long(deadline: Deadline) -> None:
    with deadline.within(10.0):
        await asyncio.sleep(60.0)


def test_work_that_is_late_is_cancelled_at_its_deadline() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        for limit_s in (5.0, 2.0, 10.0):
            begun = loop.time()
            with pytest.raises(DeadlineMissed), deadline.within(limit_s):
                await asyncio.sleep(60.0)
            assert loop.time() - begun == pytest.approx(limit_s)
        task = asyncio.current_task()
        assert task is not None
        assert task.cancelling() == 0

    run(work)


def test_a_shorter_deadline_after_a_longer_one_is_kept() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        with deadline.within(10.0):
            await asyncio.sleep(1.0)
        with pytest.raises(DeadlineMissed), deadline.within(2.0):
            await asyncio.sleep(60.0)
        assert loop.time() == pytest.approx(3.0)

    run(work)


def test_work_after_a_deadline_is_not_cancelled_by_it() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        with deadline.within(1.0):
            await asyncio.sleep(0.5)
        await asyncio.sleep(60.0)
        with deadline.within(None):
            await asyncio.sleep(60.0)
        with deadline.within(1.0):
            await asyncio.sleep(0.9)

    run(work)


def test_work_that_is_in_time_needs_few_timers() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        for _ in range(1000):
            with deadline.within(10.0):
                pass
            with deadline.within(5.0):
                pass
        assert loop.timers <= 2

    run(work)


def test_a_cancellation_by_others_is_none_by_the_deadline() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        task = asyncio.create_task(wait_too_long(deadline))
        await asyncio.sleep(1.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert loop.time() == pytest.approx(1.0)

    run(work)


def test_a_cancellation_just_as_the_deadline_is_missed_is_not_lost() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        task = asyncio.create_task(wait_too_long(deadline))
        await asyncio.sleep(0.0)
        deadline.miss()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    run(work)


def test_an_error_of_the_work_comes_out_as_it_is() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        with pytest.raises(TimeoutError) as raised, deadline.within(10.0):
            raise TimeoutError("of the work")
        assert not isinstance(raised.value, DeadlineMissed)

    run(work)


def test_work_that_answers_its_cancellation_with_a_timeout_of_its_own_is_late() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        async def give_up() -> None:
            try:
                await asyncio.sleep(60.0)
            except asyncio.CancelledError:
                raise TimeoutError from None

        with pytest.raises(DeadlineMissed), deadline.within(1.0):
            await give_up()

    run(work)


def test_work_can_be_told_that_its_time_is_over() -> None:
    async def work(loop: VirtualLoop, deadline: Deadline) -> None:
        loop.call_later(3.0, deadline.miss)
        with pytest.raises(DeadlineMissed), deadline.within(None):
            await asyncio.sleep(60.0)
        assert loop.time() == pytest.approx(3.0)

    run(work)
