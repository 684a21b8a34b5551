"""Services, actions and their clients under AsyncioExecutor, against a process with plain rclpy.

Responses wait for clients whose readers are not discovered yet.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Container
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from robot_controller.action import DrivePattern
from std_msgs.msg import String
from std_srvs.srv import SetBool

from robotctl.daemon.control.inputs import HOST
from robotctl.ros.executor import replies, requester
from robotctl.ros.executor.replies import MAX_WAITING, Replies
from robotctl.ros.executor.services import ServiceSource
from robotctl.ros.graph.endpoints import gid_of
from tests.ros.conftest import Peer
from tests.ros.open_executor import Bench
from tests.support.waiting import DEADLINE_S
from tests.support.waiting import loop_until as until


async def client_of(bench: Bench, peer: Peer, service: str, **options: Any) -> Any:
    """Return the client of a service that the peer serves."""
    await peer("serve", service=service, **options)
    return await bench.client(service)


async def test_a_service_answers_the_other_process_and_knows_that_it_is_of_this_host(
    bench: Bench, peer: Peer
) -> None:
    seen: set[bytes | None] = set()

    def answer(request: Any, response: Any) -> Any:
        seen.add(requester())
        response.success, response.message = not request.data, "here"
        return response

    bench.create_service(SetBool, bench.topic, answer)
    assert await peer("call", service=bench.topic, data=False, times=5) == [[True, "here"]] * 5
    (gid,) = seen
    assert gid is not None
    own = gid_of(bench.create_publisher(String, f"{bench.topic}_own", 1))
    assert gid[HOST] == own[HOST]
    assert gid[:12] != own[:12]
    assert requester() is None


async def test_an_async_service_may_await_asyncio_and_another_service(
    bench: Bench, peer: Peer
) -> None:
    # In the callback group of the service itself: with an executor of rclpy this deadlocks.
    client = await client_of(bench, peer, f"{bench.topic}/inner")

    async def answer(request: Any, response: Any) -> Any:
        await asyncio.sleep(0.01)
        inner = await bench.opened.call(client, request, timeout_s=DEADLINE_S)
        response.success, response.message = inner.success, f"{inner.message}, passed on"
        return response

    bench.create_service(SetBool, bench.topic, answer)
    assert await peer("call", service=bench.topic, data=True) == [
        [True, "from the peer, passed on"]
    ]


async def test_calls_in_flight_at_once_get_their_own_responses(bench: Bench, peer: Peer) -> None:
    client = await client_of(bench, peer, bench.topic)
    wanted = [number % 3 == 0 for number in range(8)]  # A service's queue holds ten.
    replies = await asyncio.gather(
        *(bench.opened.call(client, SetBool.Request(data=d), timeout_s=DEADLINE_S) for d in wanted)
    )
    assert [reply.success for reply in replies] == wanted


async def test_a_call_that_nobody_answers_ends_at_its_deadline_and_is_forgotten(
    bench: Bench,
) -> None:
    client = bench.create_client(SetBool, bench.topic)
    with pytest.raises(TimeoutError, match=f"no response from service {bench.topic} within 0.05 s"):
        await bench.opened.call(client, SetBool.Request(), timeout_s=0.05)
    assert client._pending_requests == {}
    with pytest.raises(TimeoutError, match=f"no server for {bench.topic} within 0.05 s"):
        await bench.opened.wait_for_service(client, timeout_s=0.05)


async def test_a_response_after_the_deadline_disturbs_nothing(bench: Bench, peer: Peer) -> None:
    client = await client_of(bench, peer, bench.topic, delay_s=0.2)
    with pytest.raises(TimeoutError):
        await bench.opened.call(client, SetBool.Request(), timeout_s=0.02)
    # The peer answers in order: after this response the late one has arrived as well.
    reply = await bench.opened.call(client, SetBool.Request(data=True), timeout_s=DEADLINE_S)
    assert reply.success


async def test_parameter_services_answer_the_other_process(bench: Bench, peer: Peer) -> None:
    bench.declare_parameter("laps", 3)
    assert await peer("get_parameter", node="/tested", name="laps") == 3
    assert await peer("set_parameter", node="/tested", name="laps", value=4)
    assert bench.get_parameter("laps").value == 4


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


async def test_an_action_server_runs_a_goal_of_the_other_process(bench: Bench, peer: Peer) -> None:

    async def execute(handle: Any) -> Any:
        # The goal may arrive before its feedback subscription is discovered.
        await until(lambda: bench.count_subscribers(f"{bench.topic}/_action/feedback"))
        for number in range(handle.request.laps):
            await asyncio.sleep(0.005)
            handle.publish_feedback(DrivePattern.Feedback(lap=number))
        handle.succeed()
        return DrivePattern.Result(laps=sum(range(handle.request.laps)))

    relative = bench.topic.removeprefix("/")
    assert relative != bench.topic
    server = ActionServer(bench, DrivePattern, relative, execute)
    report = await peer("run_goal", action=bench.topic, laps=5, feedbacks=5)
    server.destroy()
    assert report == {
        "accepted": True,
        "feedback": [0, 1, 2, 3, 4],
        "succeeded": True,
        "canceled": False,
        "result": 10,
    }


async def test_an_action_server_refuses_and_cancels_goals(bench: Bench, peer: Peer) -> None:

    async def execute(handle: Any) -> Any:
        number = 0
        while not handle.is_cancel_requested:
            handle.publish_feedback(DrivePattern.Feedback(lap=number))
            number += 1
            await asyncio.sleep(0.005)
        handle.canceled()
        return DrivePattern.Result(laps=7)

    server = ActionServer(
        bench,
        DrivePattern,
        bench.topic,
        execute,
        goal_callback=lambda goal: GoalResponse.ACCEPT if goal.laps else GoalResponse.REJECT,
        cancel_callback=lambda _: CancelResponse.ACCEPT,
    )
    assert (await peer("run_goal", action=bench.topic, laps=0))["accepted"] is False
    report = await peer("run_goal", action=bench.topic, laps=1, cancel_after=3)
    server.destroy()
    assert report["cancelling"] == 1
    assert report["canceled"] is True
    assert report["result"] == 7


async def test_finished_goals_are_forgotten_after_their_result_timeout(
    bench: Bench, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.ros.executor.services.EXPIRY_POLL_S", 0.05)

    async def execute(handle: Any) -> Any:
        handle.succeed()
        return DrivePattern.Result()

    server = ActionServer(bench, DrivePattern, bench.topic, execute, result_timeout=0)
    for _ in range(2):
        await peer("run_goal", action=bench.topic, laps=1)
        await until(lambda: not server._goal_handles)
        await asyncio.sleep(0.2)  # Until no check for expired goals is scheduled.
    server.destroy()


async def test_an_action_client_sends_follows_and_cancels_goals(bench: Bench, peer: Peer) -> None:
    await peer("serve_action", action=bench.topic)
    client = ActionClient(bench, DrivePattern, bench.topic)
    await bench.opened.wait_for_service(client, timeout_s=DEADLINE_S)
    async with asyncio.timeout(DEADLINE_S):
        refused = await client.send_goal_async(DrivePattern.Goal(laps=1001))
        assert not refused.accepted

        feedback: list[int] = []
        handle = await client.send_goal_async(
            DrivePattern.Goal(laps=5), feedback_callback=lambda m: feedback.append(m.feedback.lap)
        )
        result = await handle.get_result_async()
        assert result.result.laps == 10
        await until(lambda: feedback == [0, 1, 2, 3, 4])

        live: list[int] = []
        endless = await client.send_goal_async(
            DrivePattern.Goal(laps=1000), feedback_callback=lambda m: live.append(m.feedback.lap)
        )
        await until(lambda: len(live) >= 5)
        response = await endless.cancel_goal_async()
        assert len(response.goals_canceling) == 1
        assert (await endless.get_result_async()).result.laps < sum(range(1000))
    client.destroy()


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
    await until(lambda: middleware.taken)
    assert middleware.taken == ["another"], "the pause lasts"


async def test_responses_are_sent_once_the_reader_matches(
    middleware: Middleware, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replies, "PAUSE_S", 0.0)
    middleware.discovered, middleware.unmatched = {b"a"}, {b"a"}
    for text in ("1", "2", "3"):
        middleware.send(b"a", text)
    await until(lambda: len(middleware.refused) > 6)
    middleware.unmatched = set()
    await until(lambda: len(middleware.taken) == 3)
    assert sorted(middleware.taken) == ["1", "2", "3"]


async def test_a_response_is_dropped_after_its_wait_and_the_log_says_so(
    middleware: Middleware, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(replies, "WAIT_S", 0.0)
    middleware.send(b"late", "in vain")
    await until(lambda: "the service: a response was dropped" in caplog.text)
    middleware.discovered = {b"late"}
    middleware.send(b"late", "later")
    assert middleware.taken == ["later"]


async def test_a_crowd_that_cannot_be_reached_is_bounded(middleware: Middleware) -> None:
    for number in range(MAX_WAITING + 5):
        middleware.send(b"late", str(number))
    middleware.discovered = {b"late"}
    await until(lambda: len(middleware.taken) == MAX_WAITING)
    assert middleware.taken == [str(5 + number) for number in range(MAX_WAITING)]


async def test_a_response_that_cannot_be_sent_holds_up_no_other(middleware: Middleware) -> None:
    middleware.send(b"late", "impossible")
    middleware.send(b"late", "possible")
    middleware.discovered = {b"late"}
    await until(lambda: middleware.taken)
    assert middleware.errors == ["the service: impossible"]


# With the middleware


class Late:
    """Hides the readers of responses until `arrive`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._readers_of = replies.readers_of
        self._arrived = False
        monkeypatch.setattr("robotctl.ros.executor.services.readers_of", self._list)

    def arrive(self) -> None:
        self._arrived = True

    def _list(self, node: Node, service: str) -> Callable[[], Container[bytes]]:
        readers = self._readers_of(node, service)
        return lambda: readers() if self._arrived else set()


async def test_a_service_answers_once_its_client_is_discovered(
    bench: Bench, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replies, "WAIT_S", DEADLINE_S)
    late = Late(monkeypatch)
    heard: list[bool] = []

    def answer(request: Any, response: Any) -> Any:
        heard.append(request.data)
        response.success, response.message = True, "late"
        return response

    bench.create_service(SetBool, bench.topic, answer)
    call = asyncio.ensure_future(peer("call", service=bench.topic, data=True))
    await until(lambda: heard)
    await asyncio.sleep(3 * replies.POLL_S)
    assert not call.done()
    late.arrive()
    assert await call == [[True, "late"]]


async def test_a_goal_begins_once_its_client_is_discovered(
    bench: Bench, peer: Peer, monkeypatch: pytest.MonkeyPatch
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
        begun.append(handle.request.laps)
        handle.succeed()
        return DrivePattern.Result(laps=7)

    server = ActionServer(bench, DrivePattern, bench.topic, execute)
    goal = asyncio.ensure_future(peer("run_goal", action=bench.topic, laps=5))
    await until(lambda: waiting)
    await asyncio.sleep(3 * replies.POLL_S)
    assert begun == []
    late.arrive()
    report = await goal
    server.destroy()
    assert (report["succeeded"], report["result"], begun) == (True, 7, [5])


async def test_a_client_that_cannot_be_reached_holds_up_no_other(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replies, "PAUSE_S", 3600.0)
    attempts: list[bool] = []
    is_taken = replies.is_taken

    def counted(send: Callable[[], None]) -> bool:
        attempts.append(is_taken(send))
        return attempts[-1]

    monkeypatch.setattr("robotctl.ros.executor.services.is_taken", counted)
    heard: list[bool] = []

    def answer(request: Any, response: Any) -> Any:
        heard.append(request.data)
        return response

    bench.create_service(SetBool, bench.topic, answer)
    # The service's responses are volatile, so this reader never matches; its requests arrive.
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    unreachable = bench.create_client(SetBool, bench.topic, qos_profile=latched)
    while len(heard) < 3:
        unreachable.call_async(SetBool.Request(data=True))
        await asyncio.sleep(0.05)
    await until(lambda: attempts)
    assert attempts == [False]
    client = await bench.client()
    await bench.opened.call(client, SetBool.Request(), timeout_s=DEADLINE_S)
    assert attempts == [False, True]


async def test_call_async_of_rclpy_can_be_awaited_as_it_is(bench: Bench, peer: Peer) -> None:
    client = await client_of(bench, peer, bench.topic)
    async with asyncio.timeout(DEADLINE_S):
        assert (await client.call_async(SetBool.Request(data=True))).success
