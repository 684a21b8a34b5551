"""Services and their clients."""

from __future__ import annotations

from collections.abc import Coroutine
from functools import partial
from types import CoroutineType
from typing import Any

from rclpy.client import Client
from rclpy.executors import ShutdownException
from rclpy.node import Node
from rclpy.service import Service

from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.futures import ImmediateCallbacks, callbacks_at_once, fail_pending
from robotctl.ros.executor.present_request import request_of
from robotctl.ros.executor.replies import Replies, is_taken, readers_of
from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.sources.source import EventFdSource, TakeFailed


class ServiceSource(EventFdSource):
    """A service with a synchronous or async handler."""

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
            # rmw drops an unreadable request as if there were none; another may follow it.
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
    """A client; it sets the future of each request whose response came.

    Its callback group does not hold back responses: a response runs no callback of the group, and
    an async callback that awaits a client of its own group would otherwise never end.
    """

    announcements = (Announcement.RESPONSE,)

    def __init__(self, runtime: Runtime, client: Client, where: str, executor: Any) -> None:
        super().__init__(runtime, client, client.handle, where)
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
        """End every call that waits, with an error that names `reason`."""
        error = ShutdownException(f"{self.where}: {reason}")
        fail_pending(self.entity._pending_requests, error, self._immediate)
