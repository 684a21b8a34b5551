"""Waiting costs no CPU: the loop does not turn while all callbacks wait."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import ModuleType
from typing import Any

import pytest
from rclpy.action.client import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock_type import ClockType
from rclpy.parameter import Parameter
from rclpy.task import Future
from rclpy.time import Time
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor
from tests.support.rclpy_types import Node
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]
ComesToRest = Callable[[], Awaitable[bool]]


@pytest.mark.parametrize("kind", ["call", "call_async", "goal", "future", "task", "timer"])
async def test_a_coroutine_that_waits_does_not_turn_the_loop(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    borrowed_action: ModuleType,
    comes_to_rest: ComesToRest,
    kind: str,
) -> None:
    client = node.create_client(SetBool, topic)
    actions = ActionClient(node, borrowed_action.Count, topic)

    async def wait() -> None:
        match kind:
            case "call":
                await executor.call(client, SetBool.Request(), timeout_s=None)
            case "call_async":
                await client.call_async(SetBool.Request())
            case "goal":
                await actions.send_goal_async(borrowed_action.Count.Goal(1))
            case "future":
                await Future()
            case "task":
                await executor.create_task(asyncio.sleep, DEADLINE_S)
            case "timer":
                fired = asyncio.Event()
                node.create_timer(DEADLINE_S, fired.set)
                await fired.wait()

    task = asyncio.create_task(wait())
    assert await comes_to_rest()
    assert not task.done()
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    actions.destroy()


async def test_an_entity_parked_behind_its_group_does_not_turn_the_loop(
    executor: AsyncioExecutor,
    node: Node,
    topic: str,
    until: Until,
    comes_to_rest: ComesToRest,
) -> None:
    release = asyncio.Event()
    busy: list[int] = []

    async def hold(message: UInt64) -> None:
        busy.append(1)
        await release.wait()

    group = MutuallyExclusiveCallbackGroup()
    node.create_subscription(UInt64, topic, hold, 10, callback_group=group)
    node.create_publisher(UInt64, topic, 10).publish(UInt64())
    await until(lambda: busy)
    node.create_subscription(UInt64, topic, hold, 10, callback_group=group)
    node.create_timer(0.01, lambda: None, callback_group=group)
    node.create_guard_condition(lambda: None, callback_group=group).trigger()
    assert await comes_to_rest()
    release.set()


async def test_a_ros_time_timer_whose_clock_stands_still_does_not_turn_the_loop(
    executor: AsyncioExecutor, node: Node, until: Until, comes_to_rest: ComesToRest
) -> None:
    node.set_parameters([Parameter("use_sim_time", value=True)])
    clock: Any = node.get_clock()
    clock.set_ros_time_override(Time(nanoseconds=10**9, clock_type=ClockType.ROS_TIME))
    fired: list[int] = []
    node.create_timer(0.001, lambda: fired.append(1))
    await asyncio.sleep(0)
    assert await comes_to_rest()
    assert fired == []
    clock.set_ros_time_override(Time(nanoseconds=2 * 10**9, clock_type=ClockType.ROS_TIME))
    await until(lambda: fired == [1])


async def test_a_cancelled_timer_does_not_turn_the_loop(
    executor: AsyncioExecutor, node: Node, until: Until, comes_to_rest: ComesToRest
) -> None:
    fired: list[int] = []
    timer = node.create_timer(0.005, lambda: fired.append(1))
    await until(lambda: fired)
    timer.cancel()
    assert await comes_to_rest()
