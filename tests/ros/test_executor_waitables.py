"""Guard conditions and foreign Waitables under AsyncioExecutor: the wait-set thread."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from rclpy.waitable import NumberOfEntities, Waitable
from std_msgs.msg import UInt64

from robotctl.ros import AsyncioExecutor
from tests.support.rclpy_types import Node

Until = Callable[[Callable[[], object]], Awaitable[None]]


async def test_a_guard_condition_runs_its_callback_for_a_trigger_from_any_thread(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    fired: list[asyncio.AbstractEventLoop] = []
    guard = node.create_guard_condition(lambda: fired.append(asyncio.get_running_loop()))
    guard.trigger()
    await until(lambda: len(fired) == 1)
    await asyncio.to_thread(guard.trigger)
    await until(lambda: len(fired) == 2)
    assert set(fired) == {asyncio.get_running_loop()}


async def test_an_async_guard_condition_callback_may_await(
    executor: AsyncioExecutor, node: Node, until: Until
) -> None:
    fired: list[int] = []

    async def callback() -> None:
        await asyncio.sleep(0.001)
        fired.append(1)

    node.create_guard_condition(callback).trigger()
    await until(lambda: fired == [1])


class ForeignWaitable(Waitable):
    """A Waitable as a package outside rclpy would write it: around a subscription."""

    def __init__(self, node: Node, topic: str) -> None:
        super().__init__(node.default_callback_group)  # type: ignore[no-untyped-call]
        self.subscription = node.create_subscription(UInt64, topic, lambda _: None, 10)
        node._subscriptions.remove(self.subscription)
        self.index: int | None = None
        self.executed: list[int] = []

    def __enter__(self) -> None:
        self.subscription.handle.__enter__()

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self.subscription.handle.__exit__(None, None, None)

    def is_ready(self, wait_set: Any) -> bool:
        return self.index is not None and wait_set.is_ready("subscription", self.index)

    def take_data(self) -> Any:
        return self.subscription.handle.take_message(UInt64, False)

    async def execute(self, taken_data: Any) -> None:
        await asyncio.sleep(0.001)
        self.executed.append(taken_data[0].data)

    def get_num_entities(self) -> NumberOfEntities:
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        self.index = wait_set.add_subscription(self.subscription.handle)


@pytest.fixture
def waitable(node: Node, topic: str) -> Iterator[ForeignWaitable]:
    made = ForeignWaitable(node, f"{topic}/foreign")
    node.add_waitable(made)
    yield made
    node.remove_waitable(made)
    handlers: Any = made.subscription.event_handlers
    for handler in handlers:
        node.remove_waitable(handler)
    made.subscription.destroy()


@pytest.fixture
def foreign(executor: AsyncioExecutor, waitable: ForeignWaitable) -> ForeignWaitable:
    return waitable


async def test_a_foreign_waitable_is_waited_for_taken_and_executed(
    foreign: ForeignWaitable, node: Node, topic: str, until: Until
) -> None:
    publisher = node.create_publisher(UInt64, f"{topic}/foreign", 10)
    for value in (1, 2, 3):
        publisher.publish(UInt64(data=value))

        def is_executed(value: int = value) -> bool:
            return foreign.executed == list(range(1, value + 1))

        await until(is_executed)


async def test_a_foreign_waitable_parked_behind_its_group_does_not_turn_the_loop(
    foreign: ForeignWaitable,
    node: Node,
    topic: str,
    until: Until,
    comes_to_rest: Callable[[], Awaitable[bool]],
) -> None:
    release = asyncio.Event()
    busy: list[int] = []

    async def hold(message: UInt64) -> None:
        busy.append(1)
        await release.wait()

    node.create_subscription(UInt64, topic, hold, 10)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: busy)
    publisher = node.create_publisher(UInt64, f"{topic}/foreign", 10)
    publisher.publish(UInt64(data=1))
    publisher.publish(UInt64(data=2))
    assert await comes_to_rest()
    assert foreign.executed == []
    release.set()
    await until(lambda: foreign.executed == [1, 2])


@pytest.mark.parametrize("method", ["get_num_entities", "add_to_wait_set", "is_ready", "take_data"])
async def test_a_foreign_waitable_that_raises_is_reported_and_disturbs_no_guard_condition(
    context: Any,
    node: Node,
    waitable: ForeignWaitable,
    topic: str,
    until: Until,
    comes_to_rest: Callable[[], Awaitable[bool]],
    monkeypatch: pytest.MonkeyPatch,
    method: str,
) -> None:
    def fail(*_: object) -> None:
        raise ValueError("no")

    monkeypatch.setattr(waitable, method, fail)
    reported: list[str] = []
    fired: list[int] = []
    async with AsyncioExecutor(
        context, on_exception=lambda error, where: reported.append(str(error))
    ) as executor:
        executor.add_node(node)
        node.create_publisher(UInt64, f"{topic}/foreign", 10).publish(UInt64(data=1))
        guard = node.create_guard_condition(lambda: fired.append(1))
        await until(lambda: reported)
        assert await comes_to_rest()
        guard.trigger()
        await until(lambda: fired)
        monkeypatch.undo()
        await until(lambda: waitable.executed == [1])
    assert set(reported) == {"no"}
