"""Sources for services, service clients, action servers and action clients."""

from __future__ import annotations

import ctypes
from asyncio import TimerHandle
from collections import deque
from collections.abc import Coroutine
from contextlib import suppress
from functools import partial
from types import CoroutineType
from typing import Any

from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer
from rclpy.client import Client
from rclpy.executors import ShutdownException
from rclpy.node import Node
from rclpy.service import Service

from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.futures import ImmediateCallbacks, callbacks_at_once, fail_pending
from robotctl.ros.executor.replies import Replies, is_taken, readers_of, request_of
from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.source import EventFdSource, TakeFailed


class ServiceSource(EventFdSource):
    """Runs a service's handler for each request, and sends the response."""

    announcements = (Announcement.REQUEST,)

    def __init__(self, runtime: Runtime, service: Service, where: str, node: Node) -> None:
        super().__init__(runtime, service, service.handle, where)
        self._replies = Replies(runtime, where, readers_of(node, service.service_name))

    def detach(self) -> None:
        self._replies.close()
        super().detach()

    def take(self) -> Any:
        while True:
            self.announced -= 1
            try:
                request, header = self.handle.service_take_request(self.entity.srv_type.Request)
            except Exception as error:
                raise TakeFailed(error) from error
            if header is not None:
                return request, header
            # No request, or one that rmw could not read and dropped; another may follow that one.
            if self.announced <= 0:
                return None

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        request, header = item
        service = self.entity
        with request_of(header):
            response = service.callback(request, service.srv_type.Response())
        if isinstance(response, CoroutineType):
            return self._answer(response, header)
        self._send(response, header)
        return None

    async def _answer(self, response: Coroutine[Any, Any, Any], header: Any) -> None:
        self._send(await response, header)

    def _send(self, response: Any, header: Any) -> None:
        send = partial(self.entity.send_response, response, header)
        self._replies.send(header, partial(is_taken, send))


class ClientSource(EventFdSource):
    """Completes the futures of a service client's requests."""

    announcements = (Announcement.RESPONSE,)

    def __init__(self, runtime: Runtime, client: Client, where: str, executor: Any) -> None:
        super().__init__(runtime, client, client.handle, where)
        # A callback that awaits a client of its own group must not hold back the response.
        self._reentrant, self._custom_group = True, False
        self._executor = executor
        self._immediate = ImmediateCallbacks(runtime.report)

    def take(self) -> Any:
        try:
            header, response = self.handle.take_response(self.entity.srv_type.Response)
        except Exception as error:
            raise TakeFailed(error) from error
        return None if header is None else (header, response)

    def deliver(self, item: Any) -> None:
        header, response = item
        try:
            future = self.entity.get_pending_request(header.request_id.sequence_number)
        except KeyError:
            return  # The request was cancelled, or its deadline passed.
        with callbacks_at_once(future, self._immediate, self._executor):
            future.set_result(response)

    def fail_pending(self, reason: str) -> None:
        """Fail every pending call, with an error that contains `reason`."""
        error = ShutdownException(f"{self.where}: {reason}")
        fail_pending(self.entity._pending_requests, error, self._immediate)


EXPIRY_POLL_S = 1.0
"""The time between two checks for expired goals, which rcl does not announce."""


class _ActionSource(EventFdSource):
    """The base class of actions, which drives rclpy's Waitable."""

    def __init__(
        self, runtime: Runtime, entity: Any, handle: Any, where: str, executor: Any
    ) -> None:
        super().__init__(runtime, entity, handle, where)
        self._executor = executor

    def _execute(self, item: Any) -> Coroutine[Any, Any, Any]:
        for future in self.entity._futures:
            future._set_executor(self._executor)
        execution: Coroutine[Any, Any, Any] = self.entity.execute(item)
        return execution


class ActionServerSource(_ActionSource):
    """Serves an action server, and removes a finished goal after its result timeout."""

    announcements = (
        Announcement.GOAL_REQUEST,
        Announcement.CANCEL_REQUEST,
        Announcement.RESULT_REQUEST,
    )

    def __init__(
        self, runtime: Runtime, server: ActionServer, where: str, executor: Any, node: Node
    ) -> None:
        super().__init__(runtime, server, server._handle, where, executor)
        self._expiry: TimerHandle | None = None
        name = _name_of(server)
        services = {
            "goal": node.resolve_service_name(f"{name}/_action/send_goal"),
            "result": node.resolve_service_name(f"{name}/_action/get_result"),
        }
        self._replies = {
            kind: Replies(runtime, where, readers_of(node, service))
            for kind, service in services.items()
        }
        self._answerable: deque[dict[str, Any]] = deque()
        """Requests whose client can receive the response."""

    def attach(self) -> None:
        super().attach()
        self._schedule_expiry_check()

    def detach(self) -> None:
        if self._expiry is not None:
            self._expiry.cancel()
        for replies in self._replies.values():
            replies.close()
        super().detach()

    def take(self) -> Any:
        # rclpy drops a response that cannot be sent, and never executes the goal that it accepts.
        # So goals and requests for results wait until they can be answered; a cancel does not.
        while not self._answerable:
            data = self._take(expired=False)
            if data is None:
                return None
            for kind, request in data.items():
                admit = partial(self._admit, {kind: request})
                if kind in self._replies:
                    self._replies[kind].send(request[0], admit)
                else:
                    admit()
        return self._answerable.popleft()

    def _admit(self, data: dict[str, Any]) -> bool:
        self._answerable.append(data)
        self.resume()
        return True

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        self._schedule_expiry_check()
        goal = item.get("goal")
        execution = self._execute(item)
        return execution if goal is None else self._for_client(goal[0], execution)

    async def _for_client(self, header: Any, execution: Coroutine[Any, Any, Any]) -> None:
        with request_of(header):
            await execution

    def _take(self, *, expired: bool) -> Any:
        server = self.entity
        server._is_goal_request_ready = not expired
        server._is_cancel_request_ready = not expired
        server._is_result_request_ready = not expired
        server._is_goal_expired = expired
        return server.take_data() or None

    def _schedule_expiry_check(self) -> None:
        if self._expiry is None:
            self._expiry = self.runtime.loop.call_later(EXPIRY_POLL_S, self._expire)

    def _expire(self) -> None:
        self._expiry = None
        if self.closed or not self.entity._goal_handles:
            return  # There is nothing to expire until the next goal.
        self._schedule_expiry_check()
        if self._reentrant or self.group.can_execute(self.entity):
            data = self._take(expired=True)
            if data is not None and data.get("expired"):
                self.run_async(self._execute(data))


def _name_of(server: ActionServer) -> str:
    """Return the action's name as the user gave it, perhaps relative."""
    function = ctypes.CDLL("librcl_action.so").rcl_action_server_get_action_name
    function.argtypes, function.restype = [ctypes.c_void_p], ctypes.c_char_p
    with server._handle:
        name: bytes = function(server._handle.pointer)
    return name.decode()


class ActionClientSource(_ActionSource):
    """Sets the futures of an action client's responses, and runs its feedback callbacks."""

    announcements = (
        Announcement.GOAL_RESPONSE,
        Announcement.CANCEL_RESPONSE,
        Announcement.RESULT_RESPONSE,
        Announcement.FEEDBACK,
        Announcement.STATUS,
    )

    def __init__(self, runtime: Runtime, client: ActionClient, where: str, executor: Any) -> None:
        super().__init__(runtime, client, client._client_handle, where, executor)
        self._custom_group = False

    def blocked(self) -> bool:
        # Only feedback runs callbacks of the group: see `take`.
        return False

    def take(self) -> Any:
        client = self.entity
        client._is_goal_response_ready = True
        client._is_cancel_response_ready = True
        client._is_result_response_ready = True
        client._is_status_ready = True
        client._is_feedback_ready = not super().blocked()
        return client.take_data() or None

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        feedback = item.pop("feedback", None)
        if item:
            # The coroutine awaits nothing, so one step runs all of it.
            with suppress(StopIteration):
                self._execute(item).send(None)
        return None if feedback is None else self._execute({"feedback": feedback})

    def fail_pending(self, reason: str) -> None:
        """Fail every pending call, with an error that contains `reason`."""
        error = ShutdownException(f"{self.where}: {reason}")
        for pending in (
            self.entity._pending_goal_requests,
            self.entity._pending_cancel_requests,
            self.entity._pending_result_requests,
        ):
            fail_pending(pending, error, ImmediateCallbacks(self.runtime.report))
