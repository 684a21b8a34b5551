"""Action servers and clients under AsyncioExecutor, against a process with plain rclpy."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import ModuleType
from typing import Any

import pytest
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from robotctl.ros import AsyncioExecutor
from tests.support.waiting import DEADLINE_S

Until = Callable[[Callable[[], object]], Awaitable[None]]
Peer = Callable[..., Awaitable[Any]]


async def test_an_action_server_runs_a_goal_of_the_other_process(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    until: Until,
    borrowed_action: ModuleType,
) -> None:
    count = borrowed_action.Count

    async def execute(handle: Any) -> Any:
        # The goal may arrive before its feedback subscription is discovered.
        await until(lambda: node.count_subscribers(f"{topic}/_action/feedback"))
        for number in range(handle.request.value):
            await asyncio.sleep(0.005)
            handle.publish_feedback(count.Feedback(number))
        handle.succeed()
        return count.Result(sum(range(handle.request.value)))

    relative = topic.removeprefix("/")
    assert relative != topic
    server = ActionServer(node, count, relative, execute)
    report = await peer("run_goal", action=topic, value=5, feedbacks=5)
    server.destroy()
    assert report == {
        "accepted": True,
        "feedback": [0, 1, 2, 3, 4],
        "succeeded": True,
        "canceled": False,
        "result": 10,
    }


async def test_an_action_server_refuses_and_cancels_goals(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str, borrowed_action: ModuleType
) -> None:
    count = borrowed_action.Count

    async def execute(handle: Any) -> Any:
        number = 0
        while not handle.is_cancel_requested:
            handle.publish_feedback(count.Feedback(number))
            number += 1
            await asyncio.sleep(0.005)
        handle.canceled()
        return count.Result(-1)

    server = ActionServer(
        node,
        count,
        topic,
        execute,
        goal_callback=lambda goal: GoalResponse.ACCEPT if goal.value else GoalResponse.REJECT,
        cancel_callback=lambda _: CancelResponse.ACCEPT,
    )
    assert (await peer("run_goal", action=topic, value=0))["accepted"] is False
    report = await peer("run_goal", action=topic, value=1, cancel_after=3)
    server.destroy()
    assert report["cancelling"] == 1
    assert report["canceled"] is True
    assert report["result"] == -1


async def test_finished_goals_are_forgotten_after_their_result_timeout(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    until: Until,
    borrowed_action: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("robotctl.ros.executor.sources.services.EXPIRY_POLL_S", 0.05)
    count = borrowed_action.Count

    async def execute(handle: Any) -> Any:
        handle.succeed()
        return count.Result()

    server = ActionServer(node, count, topic, execute, result_timeout=0)
    for _ in range(2):
        await peer("run_goal", action=topic, value=1)
        await until(lambda: not server._goal_handles)
        await asyncio.sleep(0.2)  # Until no check for expired goals is scheduled.
    server.destroy()


async def test_an_action_client_sends_follows_and_cancels_goals(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    until: Until,
    borrowed_action: ModuleType,
) -> None:
    count = borrowed_action.Count
    await peer("serve_action", action=topic)
    client = ActionClient(node, count, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    async with asyncio.timeout(DEADLINE_S):
        refused = await client.send_goal_async(count.Goal(1001))
        assert not refused.accepted

        feedback: list[int] = []
        handle = await client.send_goal_async(
            count.Goal(5), feedback_callback=lambda m: feedback.append(m.feedback.value)
        )
        result = await handle.get_result_async()
        assert result.result.value == 10
        await until(lambda: feedback == [0, 1, 2, 3, 4])

        live: list[int] = []
        endless = await client.send_goal_async(
            count.Goal(1000), feedback_callback=lambda m: live.append(m.feedback.value)
        )
        await until(lambda: len(live) >= 5)
        response = await endless.cancel_goal_async()
        assert len(response.goals_canceling) == 1
        assert (await endless.get_result_async()).result.value < sum(range(1000))
    client.destroy()
