"""No entity holds the loop longer than its slice, whatever its backlog.

SCHED_FIFO for the loop's thread, where it is permitted.
A callback that holds the loop is named, with its duration.
"""

from __future__ import annotations

import asyncio
import os
import re
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from rclpy.callback_groups import (
    CallbackGroup,
    MutuallyExclusiveCallbackGroup,
    ReentrantCallbackGroup,
)
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor, RawTap, Ticker
from robotctl.ros.executor.event_loop import SHORTEST_SLICE_NS, SLICE_NS, TURN_NS
from tests.ros.open_executor import Bench, Node
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until


@pytest.mark.parametrize("raw", [False, True])
async def test_a_flooded_subscription_ends_its_slice_and_goes_on_in_the_next(
    bench: Bench, raw: bool
) -> None:
    turns: list[int] = []
    turn = 0

    def work(*_: Any) -> None:
        time.sleep(0.0001)
        turns.append(turn)

    bench.listen(RawTap(work) if raw else work, depth=1000, raw=raw)
    await asyncio.sleep(0.01)
    bench.publish(*range(200))
    async with asyncio.timeout(DEADLINE_S):
        while len(turns) < 200:
            turn += 1
            await asyncio.sleep(0)
    # 0.1 ms each in slices of 0.3 ms: a few a turn, never a long run.
    per_turn = [turns.count(number) for number in set(turns)]
    assert max(per_turn) <= 1 + SLICE_NS // 100_000
    assert len(per_turn) >= 200 // (1 + SLICE_NS // 100_000)


async def test_a_flood_delays_neither_a_service_nor_the_tick_by_its_backlog(bench: Bench) -> None:
    got: list[int] = []

    def work(message: UInt64) -> None:
        time.sleep(0.0005)
        got.append(message.data)

    bench.listen(work, depth=2000)
    bench.create_service(SetBool, bench.topic, lambda request, response: response)
    client, backlog = await bench.client(), 1000
    bench.publish(*range(backlog))
    # Half a second of work waits. Later entities are served before it is done.
    async with asyncio.timeout(DEADLINE_S), Ticker(1000.0) as ticker:
        for _ in range(2):
            await bench.opened.call(client, SetBool.Request(), timeout_s=DEADLINE_S)
            await anext(ticker)
    assert 0 < len(got) < backlog
    await until(lambda: len(got) == backlog)


async def test_many_flooded_entities_share_one_turn(bench: Bench) -> None:
    runtime = bench.runtime
    floods = 10
    got = [0] * floods
    slices: set[int] = set()

    def worker(index: int) -> Callable[[UInt64], None]:
        def work(message: UInt64) -> None:
            time.sleep(0.0001)
            slices.add(runtime.slice_ns)
            got[index] += 1

        return work

    topics = [f"{bench.topic}/n{index}" for index in range(floods)]
    for index, topic in enumerate(topics):
        bench.listen(worker(index), topic, 100)
    await asyncio.sleep(0.01)
    for topic in topics:
        bench.publish(*range(50), topic=topic)
    await until(lambda: got == [50] * floods)
    assert min(slices) == max(TURN_NS // floods, SHORTEST_SLICE_NS)
    await until(lambda: runtime.slice_ns == SLICE_NS)


async def test_the_executor_says_how_its_thread_is_scheduled_and_undoes_it(context: Any) -> None:
    before = os.sched_getscheduler(0)
    executor = AsyncioExecutor(context, fifo_priority=10)
    async with executor:
        granted = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
        assert executor.scheduling.startswith("SCHED_FIFO 10" if granted else "SCHED_OTHER (")
        policies: list[int] = []
        thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
        assert policies == [os.SCHED_OTHER]
    assert os.sched_getscheduler(0) == before
    assert AsyncioExecutor(context).scheduling == "SCHED_OTHER"


async def test_sched_fifo_refused_by_the_kernel_is_said_and_nothing_else(
    context: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    async with AsyncioExecutor(context, fifo_priority=10) as executor:
        assert "SCHED_FIFO 10 is not permitted" in executor.scheduling


@pytest.mark.parametrize("priority", [0, 100])
def test_a_priority_outside_1_to_99_is_refused(context: Any, priority: int) -> None:
    with pytest.raises(ValueError, match="1 to 99"):
        AsyncioExecutor(context, fifo_priority=priority)


def named_ms(caplog: pytest.LogCaptureFixture, whom: str) -> list[int]:
    """Return the durations in the warnings about one callback; a busy machine may cause others."""
    found = (re.search(r"(.*) held the loop for (\d+) ms", text) for text in caplog.messages)
    return [int(each[2]) for each in found if each is not None and whom in each[1]]


@pytest.mark.parametrize("kind", ["subscription", "tap", "service", "timer", "guard", "task"])
async def test_a_callback_that_holds_the_loop_is_named_with_its_duration(
    bench: Bench, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
    def hog(*arguments: Any) -> Any:
        time.sleep(0.06)
        return arguments[-1] if arguments else None

    match kind:
        case "subscription":
            bench.listen(hog)
        case "tap":
            bench.listen(RawTap(hog), raw=True)
        case "service":
            bench.create_service(SetBool, bench.topic, hog)
            bench.create_client(SetBool, bench.topic).call_async(SetBool.Request())
        case "timer":
            bench.create_timer(0.1, hog)
        case "guard":
            bench.create_guard_condition(hog).trigger()
        case "task":
            bench.opened.create_task(hog)
    bench.publish(0)
    await until(lambda: any(ms >= 60 for ms in named_ms(caplog, kind)))
    assert ("hog" in caplog.text) or kind == "tap"


async def test_a_callback_that_blocks_again_and_again_is_not_named_every_time(
    bench: Bench, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    called: list[int] = []

    def hog() -> None:
        called.append(1)
        time.sleep(0.06)

    bench.create_timer(0.001, hog)
    await until(lambda: len(called) >= 3)
    assert len(named_ms(caplog, "hog")) == 1
    monkeypatch.setattr(bench.runtime.slow, "_quiet_until_ns", {})
    await until(lambda: len(named_ms(caplog, "hog")) == 2)
    assert "times since the last warning" in caplog.text


async def test_an_async_callback_that_blocks_between_two_awaits_is_named(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    took_ms: list[float] = []

    async def hog(message: UInt64) -> None:
        begun = time.monotonic()
        await asyncio.sleep(0.2)
        time.sleep(0.06)  # noqa: ASYNC251 - it is to block
        took_ms.append((time.monotonic() - begun) * 1e3)
        await asyncio.sleep(0)

    bench.listen(hog)
    bench.publish(0)
    await until(lambda: any(ms >= 60 for ms in named_ms(caplog, "hog")))
    assert max(named_ms(caplog, "hog")) < took_ms[0]  # the time of its wait does not count


class Overlap:
    """Async callbacks that record how many of them run at once."""

    def __init__(self) -> None:
        self.running = 0
        self.most = 0
        self.done: list[str] = []

    async def run(self, name: str) -> None:
        self.running += 1
        self.most = max(self.most, self.running)
        await asyncio.sleep(0.005)
        self.running -= 1
        self.done.append(name)


def make_everything(node: Node, topic: str, group: CallbackGroup, overlap: Overlap) -> None:
    """Create a subscription, a service, a timer and a guard condition, each with work to do."""

    async def on_message(message: UInt64) -> None:
        await overlap.run("subscription")

    async def on_request(request: Any, response: Any) -> Any:
        await overlap.run("service")
        return response

    async def on_timer() -> None:
        await overlap.run("timer")

    async def on_guard() -> None:
        await overlap.run("guard")

    node.create_subscription(UInt64, topic, on_message, 10, callback_group=group)
    node.create_service(SetBool, topic, on_request, callback_group=group)
    client = node.create_client(SetBool, topic)
    node.create_timer(0.002, on_timer, callback_group=group)
    node.create_guard_condition(on_guard, callback_group=group).trigger()
    publisher = node.create_publisher(UInt64, topic, 10)
    for value in range(5):
        publisher.publish(UInt64(data=value))
    client.call_async(SetBool.Request())


@pytest.mark.parametrize("kind", [MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup])
async def test_async_callbacks_overlap_in_a_reentrant_group_only(
    bench: Bench, kind: type[CallbackGroup]
) -> None:
    overlap = Overlap()
    make_everything(bench, bench.topic, kind(), overlap)
    await until(lambda: overlap.done.count("subscription") == 5)
    await until(lambda: {*overlap.done} == {"subscription", "service", "timer", "guard"})
    assert (overlap.most > 1) is (kind is ReentrantCallbackGroup)


async def test_a_group_of_the_users_own_is_asked_for_every_callback(bench: Bench) -> None:
    class Counting(CallbackGroup):
        open_now = 0
        begun = 0

        def can_execute(self, entity: Any) -> bool:
            return self.open_now == 0

        def beginning_execution(self, entity: Any) -> bool:
            assert self.open_now == 0
            self.open_now += 1
            self.begun += 1
            return True

        def ending_execution(self, entity: Any) -> None:
            self.open_now -= 1

    group = Counting()
    got: list[int] = []
    open_in_callback: list[int] = []

    def callback(message: UInt64) -> None:
        got.append(message.data)
        open_in_callback.append(group.open_now)

    others: dict[str, int] = {}
    bench.create_timer(0.001, lambda: others.update(timer=group.open_now), callback_group=group)
    guard = bench.create_guard_condition(
        lambda: others.update(guard=group.open_now), callback_group=group
    )
    guard.trigger()
    bench.listen(callback, callback_group=group)
    bench.publish(*range(5))
    await until(lambda: got == [0, 1, 2, 3, 4])
    await until(lambda: len(others) == 2)
    assert open_in_callback == [1] * 5
    assert others == {"timer": 1, "guard": 1}
    assert group.begun >= 5
    assert group.open_now == 0


async def test_a_cancelled_async_callback_frees_its_group(bench: Bench) -> None:
    tasks: list[asyncio.Task[Any]] = []
    got: list[int] = []

    async def callback(message: UInt64) -> None:
        got.append(message.data)
        if message.data == 0:
            task = asyncio.current_task()
            assert task is not None
            tasks.append(task)
            await asyncio.sleep(DEADLINE_S)

    bench.listen(callback)
    bench.publish(0, 1)
    await until(lambda: tasks)
    assert got == [0]
    tasks[0].cancel()
    await until(lambda: got == [0, 1])


async def test_a_guard_condition_triggered_while_its_group_is_busy_runs_afterwards(
    bench: Bench,
) -> None:
    release = asyncio.Event()
    order: list[str] = []

    async def hold(message: UInt64) -> None:
        order.append("held")
        await release.wait()
        order.append("free")

    group = MutuallyExclusiveCallbackGroup()
    bench.listen(hold, callback_group=group)
    guard = bench.create_guard_condition(lambda: order.append("guard"), callback_group=group)
    seen: list[int] = []
    free = bench.create_guard_condition(
        lambda: seen.append(1), callback_group=ReentrantCallbackGroup()
    )
    bench.publish(0)
    await until(lambda: order == ["held"])
    guard.trigger()
    free.trigger()
    await until(lambda: seen)
    assert order == ["held"]
    release.set()
    await until(lambda: order == ["held", "free", "guard"])


async def test_a_parked_entity_may_be_destroyed(bench: Bench) -> None:
    release = asyncio.Event()
    got: list[int] = []

    async def callback(message: UInt64) -> None:
        got.append(message.data)
        await release.wait()

    group = MutuallyExclusiveCallbackGroup()
    bench.listen(callback, callback_group=group)
    topic = f"{bench.topic}/parked"
    parked = bench.hear(topic, callback_group=group)
    seen = bench.hear(topic, callback_group=ReentrantCallbackGroup())
    bench.publish(7)
    await until(lambda: got == [7])
    bench.publish(0, topic=topic)
    await until(lambda: seen)
    bench.destroy_subscription(parked.entity)
    await asyncio.sleep(0)
    release.set()
    await until(lambda: not bench.runtime.tasks)
    assert (got, parked) == ([7], [])
