"""Action servers and clients: three services or five sources behind one eventfd."""

from __future__ import annotations

from asyncio import TimerHandle
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any

from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer
from rclpy.executors import ShutdownException

from robotctl.ros.executor.announcements import Announcement
from robotctl.ros.executor.futures import CallbacksNow, fail_pending
from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.sources.source import EventFdSource

EXPIRY_POLL_S = 1.0
"""How often finished goals are looked at: rcl keeps their expiry in a timer of its own."""


class _ActionSource(EventFdSource):
    """What the two have in common: rclpy's Waitable takes and executes, we say when."""

    def __init__(
        self, runtime: Runtime, entity: Any, handle: Any, where: str, executor: Any
    ) -> None:
        super().__init__(runtime, entity, handle, where)
        self._executor = executor

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        return self._execute(item)

    def _execute(self, item: Any) -> Coroutine[Any, Any, Any]:
        for future in self.entity._futures:
            future._set_executor(self._executor)
        execution: Coroutine[Any, Any, Any] = self.entity.execute(item)
        return execution


class ActionServerSource(_ActionSource):
    """An action server; finished goals are forgotten when their result timeout is over."""

    announcements = (
        Announcement.GOAL_REQUEST,
        Announcement.CANCEL_REQUEST,
        Announcement.RESULT_REQUEST,
    )

    def __init__(self, runtime: Runtime, server: ActionServer, where: str, executor: Any) -> None:
        super().__init__(runtime, server, server._handle, where, executor)
        self._expiry: TimerHandle | None = None

    def attach(self) -> None:
        super().attach()
        self._look_for_expired_later()

    def detach(self) -> None:
        if self._expiry is not None:
            self._expiry.cancel()
        super().detach()

    def take(self) -> Any:
        return self._take(expired=False)

    def deliver(self, item: Any) -> Coroutine[Any, Any, Any] | None:
        self._look_for_expired_later()
        return super().deliver(item)

    def _take(self, *, expired: bool) -> Any:
        server = self.entity
        server._is_goal_request_ready = not expired
        server._is_cancel_request_ready = not expired
        server._is_result_request_ready = not expired
        server._is_goal_expired = expired
        return server.take_data() or None

    def _look_for_expired_later(self) -> None:
        if self._expiry is None:
            self._expiry = self.runtime.loop.call_later(EXPIRY_POLL_S, self._expire)

    def _expire(self) -> None:
        self._expiry = None
        if self.closed or not self.entity._goal_handles:
            return  # Until the next goal there is nothing to look for.
        self._look_for_expired_later()
        if self._free or self.group.can_execute(self.entity):
            data = self._take(expired=True)
            if data is not None and data.get("expired"):
                self.run_async(self._execute(data))


class ActionClientSource(_ActionSource):
    """An action client.

    Its callback group holds back feedback only, which runs a callback; responses and status just
    resolve futures (see `ClientSource`).
    """

    announcements = (
        Announcement.GOAL_RESPONSE,
        Announcement.CANCEL_RESPONSE,
        Announcement.RESULT_RESPONSE,
        Announcement.FEEDBACK,
        Announcement.STATUS,
    )

    def __init__(self, runtime: Runtime, client: ActionClient, where: str, executor: Any) -> None:
        super().__init__(runtime, client, client._client_handle, where, executor)
        self._strict = False

    def blocked(self) -> bool:
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
            # Nothing in there awaits anything: one step is the whole of it.
            with suppress(StopIteration):
                self._execute(item).send(None)
        return None if feedback is None else self._execute({"feedback": feedback})

    def fail_pending(self, reason: str) -> None:
        """Nobody will answer any more: end every call that waits."""
        error = ShutdownException(f"{self.where}: {reason}")
        for pending in (
            self.entity._pending_goal_requests,
            self.entity._pending_cancel_requests,
            self.entity._pending_result_requests,
        ):
            fail_pending(pending, error, CallbacksNow(self.runtime.report))
