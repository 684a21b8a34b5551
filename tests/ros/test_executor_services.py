"""Services and clients under AsyncioExecutor, against a process with plain rclpy."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from rclpy.client import Client
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import SetBool

from robotctl.daemon.remote_requests import HOST
from robotctl.ros import AsyncioExecutor
from robotctl.ros.executor import requester
from robotctl.ros.executor.sources.services import ServiceSource
from robotctl.ros.graph.endpoints import gid_of
from tests.support.waiting import DEADLINE_S

Peer = Callable[..., Awaitable[Any]]


async def client_of(
    peer: Peer, executor: AsyncioExecutor, node: Node, service: str, **options: Any
) -> Client:
    """Return the client of a service that the peer serves."""
    await peer("serve", service=service, **options)
    client = node.create_client(SetBool, service)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    return client


async def test_a_synchronous_service_answers_the_other_process(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    def answer(request: Any, response: Any) -> Any:
        response.success, response.message = not request.data, "here"
        return response

    node.create_service(SetBool, topic, answer)
    assert await peer("call", service=topic, data=False, times=5) == [[True, "here"]] * 5


async def test_an_async_service_may_await_asyncio_and_another_service(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    # In the callback group of the service itself: with an executor of rclpy this deadlocks.
    client = await client_of(peer, executor, node, f"{topic}/inner")

    async def answer(request: Any, response: Any) -> Any:
        await asyncio.sleep(0.01)
        inner = await executor.call(client, request, timeout_s=DEADLINE_S)
        response.success, response.message = inner.success, f"{inner.message}, passed on"
        return response

    node.create_service(SetBool, topic, answer)
    assert await peer("call", service=topic, data=True) == [[True, "from the peer, passed on"]]


async def test_call_returns_the_response_of_the_other_process(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    client = await client_of(peer, executor, node, topic)
    for data in (True, False):
        reply = await executor.call(client, SetBool.Request(data=data), timeout_s=DEADLINE_S)
        assert (reply.success, reply.message) == (data, "from the peer")


async def test_calls_in_flight_at_once_get_their_own_responses(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    client = await client_of(peer, executor, node, topic)
    wanted = [number % 3 == 0 for number in range(8)]  # A service's queue holds ten.
    replies = await asyncio.gather(
        *(executor.call(client, SetBool.Request(data=d), timeout_s=DEADLINE_S) for d in wanted)
    )
    assert [reply.success for reply in replies] == wanted


async def test_call_async_of_rclpy_can_be_awaited_as_it_is(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    client = await client_of(peer, executor, node, topic)
    async with asyncio.timeout(DEADLINE_S):
        assert (await client.call_async(SetBool.Request(data=True))).success


async def test_a_call_that_nobody_answers_ends_at_its_deadline_and_is_forgotten(
    executor: AsyncioExecutor, node: Node, topic: str
) -> None:
    client = node.create_client(SetBool, topic)
    with pytest.raises(TimeoutError, match=f"no response from service {topic} within 0.05 s"):
        await executor.call(client, SetBool.Request(), timeout_s=0.05)
    assert client._pending_requests == {}
    with pytest.raises(TimeoutError, match=f"no server for {topic} within 0.05 s"):
        await executor.wait_for_service(client, timeout_s=0.05)


async def test_a_response_after_the_deadline_disturbs_nothing(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    client = await client_of(peer, executor, node, topic, delay_s=0.2)
    with pytest.raises(TimeoutError):
        await executor.call(client, SetBool.Request(), timeout_s=0.02)
    # The peer answers in order: after this response the late one has arrived as well.
    reply = await executor.call(client, SetBool.Request(data=True), timeout_s=DEADLINE_S)
    assert reply.success


async def test_parameter_services_answer_the_other_process(
    executor: AsyncioExecutor, node: Node, peer: Peer
) -> None:
    node.declare_parameter("laps", 3)
    assert await peer("get_parameter", node="/tested", name="laps") == 3
    assert await peer("set_parameter", node="/tested", name="laps", value=4)
    assert node.get_parameter("laps").value == 4


class Queue:
    """Replaces rcl's queue: an unreadable request is taken as if there were none."""

    def __init__(self, *requests: str) -> None:
        self.requests = list(requests)

    def service_take_request(self, kind: object) -> tuple[object, object]:
        request = self.requests.pop(0) if self.requests else ""
        return (request, "header") if request else (None, None)


@pytest.mark.parametrize("unreadable", [0, 1, 5])
def test_requests_that_cannot_be_read_hide_none_that_stands_behind(unreadable: int) -> None:
    source = object.__new__(ServiceSource)
    handle: Any = Queue(*[""] * unreadable, "stop")
    source.handle = handle
    source.entity = type("Service", (), {"srv_type": SetBool})
    source.announced = unreadable + 1
    assert source.take() == ("stop", "header")
    assert source.take() is None


async def test_a_handler_knows_its_client_and_that_it_is_of_this_host(
    executor: AsyncioExecutor, node: Node, peer: Peer, topic: str
) -> None:
    seen: list[bytes | None] = []

    def answer(request: Any, response: Any) -> Any:
        seen.append(requester())
        return response

    node.create_service(SetBool, topic, answer)
    await peer("call", service=topic, data=True)
    (gid,) = seen
    assert gid is not None
    own = gid_of(node.create_publisher(String, f"{topic}_own", 1))
    assert gid[HOST] == own[HOST]
    assert gid[:12] != own[:12]
    assert requester() is None
