"""The mode service passes requests to the kernel, returns its replies, and shows the status."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Reply
from robotctl.ros.graph import endpoints
from robotctl.ros.messages import qos
from robotctl.ros.nodes import mode_service
from robotctl.ros.nodes.mode_service import ModeService, Shown
from robotctl.ros.session import Session

Until = Callable[[Callable[[], object]], Awaitable[None]]


def replied(reply: Reply) -> asyncio.Future[Reply]:
    """Return a reply that is there at once."""
    future: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
    future.set_result(reply)
    return future


async def test_the_status_is_shown_to_whoever_comes_late(
    session: Session, executor: Any, node: Any, until: Until
) -> None:
    from robot_controller.msg import RobotStatus

    service = ModeService(session, "r2", lambda requested, source: asyncio.Future())
    service.publish(Shown(Mode.ERROR, math.nan, False))
    service.publish(Shown(Mode.MOVING, 0.75, True))
    shown: list[Any] = []
    node.create_subscription(RobotStatus, service.status_topic, shown.append, qos.LATCHED)
    await until(lambda: shown)
    (status,) = shown
    assert (status.robot_name, status.mode, status.battery_level) == ("r2", 1, 0.75)
    assert status.is_connected is True
    assert math.isnan(status.cpu_temperature) or -50.0 < status.cpu_temperature < 150.0


async def test_a_call_is_answered_with_what_was_decided(
    session: Session, executor: Any, node: Any
) -> None:
    from robot_controller.srv import SetMode

    asked: list[tuple[int, str]] = []

    def refuse(requested: int, source: str) -> asyncio.Future[Reply]:
        asked.append((requested, source))
        return replied(Reply(1, False, "because", Mode.EMERGENCY_STOP))

    ModeService(session, "r2", refuse, lambda reply: reply.message.upper())
    client = node.create_client(SetMode, "/r2/set_mode")
    await executor.wait_for_service(client, timeout_s=20.0)
    answer = await executor.call(client, SetMode.Request(requested_mode=200), timeout_s=20.0)
    assert (answer.success, answer.message, answer.current_mode) == (False, "BECAUSE", 3)
    assert asked == [(200, "the ROS service /r2/set_mode")]


async def test_a_call_of_estop_asks_for_an_emergency_stop(
    session: Session, executor: Any, node: Any
) -> None:
    from std_srvs.srv import Trigger

    asked: list[tuple[int, str]] = []

    def stop(requested: int, source: str) -> asyncio.Future[Reply]:
        asked.append((requested, source))
        return replied(Reply(1, True, "stopped", Mode.EMERGENCY_STOP))

    ModeService(session, "r2", stop)
    client = node.create_client(Trigger, "/r2/estop")
    await executor.wait_for_service(client, timeout_s=20.0)
    answer = await executor.call(client, Trigger.Request(), timeout_s=20.0)
    assert (answer.success, answer.message) == (True, "stopped")
    assert asked == [(3, "the ROS service /r2/estop")]


async def test_requests_beyond_the_limit_are_refused_as_busy_and_stops_are_not(
    session: Session, executor: Any, node: Any, until: Until, monkeypatch: pytest.MonkeyPatch
) -> None:
    from robot_controller.srv import SetMode
    from std_srvs.srv import Trigger

    monkeypatch.setattr(mode_service, "MAX_IN_WORK", 3)
    pending: list[asyncio.Future[Reply]] = []

    def wait(requested: int, source: str) -> asyncio.Future[Reply]:
        pending.append(asyncio.get_running_loop().create_future())
        return pending[-1] if requested != 3 else replied(Reply(1, True, "", Mode.EMERGENCY_STOP))

    service = ModeService(session, "r2", wait)
    service.publish(Shown(Mode.MOVING, 1.0, True))
    set_mode = node.create_client(SetMode, "/r2/set_mode")
    estop = node.create_client(Trigger, "/r2/estop")
    for client in (set_mode, estop):
        await executor.wait_for_service(client, timeout_s=20.0)

    def ask(mode: int) -> asyncio.Task[Any]:
        request = SetMode.Request(requested_mode=mode)
        return asyncio.create_task(executor.call(set_mode, request, timeout_s=20.0))

    waiting = [ask(0) for _ in range(3)]
    await asyncio.sleep(0)  # until the calls are made
    refused = await ask(0)
    assert (refused.success, refused.current_mode) == (False, 1)
    assert refused.message == "busy: 3 requests wait for their reply; try again"
    assert (await ask(3)).success
    assert (await executor.call(estop, Trigger.Request(), timeout_s=20.0)).success
    for future in pending[:3]:
        future.set_result(Reply(1, True, "done", Mode.IDLE))
    assert [(await call).message for call in waiting] == ["done"] * 3
    again = ask(0)
    await until(lambda: len(pending) == 6)
    pending[-1].set_result(Reply(1, True, "taken again", Mode.IDLE))
    assert (await again).message == "taken again"


async def test_what_the_mode_service_publishes_is_what_it_declares(session: Session) -> None:
    service = ModeService(session, "r2", lambda mode, source: asyncio.Future())
    for topic in (mode_service.STATUS, *mode_service.CALLS):
        (found,) = endpoints.publishers(service.node, session.resolve(topic.name))
        offered = found.qos_profile
        assert found.topic_type == topic.type_name
        assert offered.durability is topic.qos.durability
        assert offered.reliability is topic.qos.reliability
