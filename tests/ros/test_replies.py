"""Responses wait for clients whose readers are not discovered yet."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Container
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from rclpy.action.server import ActionServer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool

from robotctl.ros import AsyncioExecutor
from robotctl.ros.executor import replies
from robotctl.ros.executor.replies import MAX_WAITING, Replies
from tests.support.waiting import DEADLINE_S, loop_until

Peer = Callable[..., Awaitable[Any]]


class Middleware:
    """Knows some readers, takes responses to some of them, and keeps what it took."""

    def __init__(self) -> None:
        self.discovered: set[bytes] = set()
        self.unmatched: set[bytes] = set()
        self.taken: list[str] = []
        self.refused: list[str] = []
        self.errors: list[str] = []
        runtime: Any = SimpleNamespace(loop=asyncio.get_running_loop(), report=self._report)
        self.replies = Replies(runtime, "the service", lambda: self.discovered)

    def send(self, gid: bytes, text: str) -> None:
        def attempt() -> bool:
            if gid in self.unmatched:
                self.refused.append(text)
                return False
            if text == "impossible":
                raise ValueError(text)
            self.taken.append(text)
            return True

        self.replies.send(gid, attempt)

    def _report(self, error: Exception, where: str) -> None:
        self.errors.append(f"{where}: {error}")


@pytest.fixture
async def middleware(monkeypatch: pytest.MonkeyPatch) -> Middleware:
    monkeypatch.setattr(replies, "reader_of", lambda header: header)
    return Middleware()


async def test_a_response_waits_for_its_reader_and_is_sent_once(middleware: Middleware) -> None:
    middleware.send(b"late", "waits")
    middleware.discovered = {b"here"}
    middleware.send(b"here", "at once")
    assert middleware.taken == ["at once"]
    middleware.discovered = {b"here", b"late"}
    await loop_until(lambda: len(middleware.taken) > 1)
    middleware.send(b"late", "at once, too")
    assert middleware.taken == ["at once", "waits", "at once, too"]


async def test_an_unmatched_reader_is_tried_rarely(
    middleware: Middleware, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replies, "PAUSE_S", 3600.0)
    middleware.discovered, middleware.unmatched = {b"a"}, {b"a"}
    for text in ("1", "2", "3"):
        middleware.send(b"a", text)
    assert middleware.refused == ["1"], "each attempt holds the loop up"
    middleware.unmatched = set()
    middleware.send(b"b", "another")
    middleware.discovered = {b"a", b"b"}
    await loop_until(lambda: middleware.taken)
    assert middleware.taken == ["another"], "the pause lasts"


async def test_responses_are_sent_once_the_reader_matches(
    middleware: Middleware, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replies, "PAUSE_S", 0.0)
    middleware.discovered, middleware.unmatched = {b"a"}, {b"a"}
    for text in ("1", "2", "3"):
        middleware.send(b"a", text)
    await loop_until(lambda: len(middleware.refused) > 6)
    middleware.unmatched = set()
    await loop_until(lambda: len(middleware.taken) == 3)
    assert sorted(middleware.taken) == ["1", "2", "3"]


async def test_a_response_is_dropped_after_its_wait_and_the_log_says_so(
    middleware: Middleware, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(replies, "WAIT_S", 0.0)
    middleware.send(b"late", "in vain")
    await loop_until(lambda: "the service: a response was dropped" in caplog.text)
    middleware.discovered = {b"late"}
    middleware.send(b"late", "later")
    assert middleware.taken == ["later"]


async def test_a_crowd_that_cannot_be_reached_is_bounded(middleware: Middleware) -> None:
    for number in range(MAX_WAITING + 5):
        middleware.send(b"late", str(number))
    middleware.discovered = {b"late"}
    await loop_until(lambda: len(middleware.taken) == MAX_WAITING)
    assert middleware.taken == [str(5 + number) for number in range(MAX_WAITING)]


async def test_a_response_that_cannot_be_sent_holds_up_no_other(middleware: Middleware) -> None:
    middleware.send(b"late", "impossible")
    middleware.send(b"late", "possible")
    middleware.discovered = {b"late"}
    await loop_until(lambda: middleware.taken)
    assert middleware.errors == ["the service: impossible"]


# With the middleware


async def test_a_client_that_cannot_be_reached_holds_up_no_other(
    executor: AsyncioExecutor, node: Node, topic: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replies, "PAUSE_S", 3600.0)
    attempts: list[bool] = []
    is_taken = replies.is_taken

    def counted(send: Callable[[], None]) -> bool:
        attempts.append(is_taken(send))
        return attempts[-1]

    monkeypatch.setattr("robotctl.ros.executor.sources.services.is_taken", counted)
    heard: list[bool] = []

    def answer(request: Any, response: Any) -> Any:
        heard.append(request.data)
        return response

    node.create_service(SetBool, topic, answer)
    # The service's responses are volatile, so this reader never matches; its requests arrive.
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    unreachable = node.create_client(SetBool, topic, qos_profile=latched)
    while len(heard) < 3:
        unreachable.call_async(SetBool.Request(data=True))
        await asyncio.sleep(0.05)
    await loop_until(lambda: attempts)
    assert attempts == [False]
    client = node.create_client(SetBool, topic)
    await executor.wait_for_service(client, timeout_s=DEADLINE_S)
    await executor.call(client, SetBool.Request(), timeout_s=DEADLINE_S)
    assert attempts == [False, True]


class Late:
    """Hides the readers of responses until `arrive`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._readers_of = replies.readers_of
        self._arrived = False
        monkeypatch.setattr("robotctl.ros.executor.sources.services.readers_of", self._list)

    def arrive(self) -> None:
        self._arrived = True

    def _list(self, node: Node, service: str) -> Callable[[], Container[bytes]]:
        readers = self._readers_of(node, service)
        return lambda: readers() if self._arrived else set()


async def test_a_service_answers_once_its_client_is_discovered(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(replies, "WAIT_S", DEADLINE_S)
    late = Late(monkeypatch)
    heard: list[bool] = []

    def answer(request: Any, response: Any) -> Any:
        heard.append(request.data)
        response.success, response.message = True, "late"
        return response

    node.create_service(SetBool, topic, answer)
    call = asyncio.ensure_future(peer("call", service=topic, data=True))
    await loop_until(lambda: heard)
    await asyncio.sleep(3 * replies.POLL_S)
    assert not call.done()
    late.arrive()
    assert await call == [[True, "late"]]


async def test_a_goal_begins_once_its_client_is_discovered(
    executor: AsyncioExecutor,
    node: Node,
    peer: Peer,
    topic: str,
    borrowed_action: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(replies, "WAIT_S", DEADLINE_S)
    late = Late(monkeypatch)
    begun: list[int] = []
    waiting: list[object] = []
    send = Replies.send

    def seen(self: Replies, header: object, attempt: Callable[[], bool]) -> None:
        waiting.append(header)
        send(self, header, attempt)

    monkeypatch.setattr(Replies, "send", seen)

    async def execute(handle: Any) -> Any:
        begun.append(handle.request.value)
        handle.succeed()
        return borrowed_action.Count.Result(7)

    server = ActionServer(node, borrowed_action.Count, topic, execute)
    goal = asyncio.ensure_future(peer("run_goal", action=topic, value=5))
    await loop_until(lambda: waiting)
    await asyncio.sleep(3 * replies.POLL_S)
    assert begun == []
    late.arrive()
    report = await goal
    server.destroy()
    assert (report["succeeded"], report["result"], begun) == (True, 7, [5])
