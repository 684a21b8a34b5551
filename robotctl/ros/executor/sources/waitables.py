"""Guard conditions and foreign Waitables, which rcl does not announce on an eventfd."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.guard_condition import GuardCondition
from rclpy.waitable import Waitable

from robotctl.ros.executor.runtime import Runtime
from robotctl.ros.executor.sources.source import RETRY_AFTER_FAILED_TAKE_S
from robotctl.ros.executor.sources.waitset import WaitSetSource, WaitSetThread


class GuardSource(WaitSetSource):
    """A guard condition."""

    _triggered = False

    def __init__(
        self, runtime: Runtime, guard: GuardCondition, where: str, thread: WaitSetThread
    ) -> None:
        super().__init__(runtime, guard, guard.handle, where, thread)

    def counts(self) -> tuple[int, int, int, int, int, int]:
        return (0, 1, 0, 0, 0, 0)

    def fill(self, wait_set: Any) -> None:
        wait_set.add_guard_condition(self.handle)

    def run_if_ready(self, wait_set: Any) -> None:
        if self.handle.pointer in wait_set.get_ready_entities("guard_condition"):
            self._call()

    def resume(self) -> None:
        # Waiting has reset the condition: only this source knows that it was triggered.
        if self._triggered and not self.closed:
            self._call()

    def _call(self) -> None:
        if self.entity.callback is not None:
            self._triggered = self.blocked() or not self.run_callback(self.entity.callback)


class WaitableSource(WaitSetSource):
    """A Waitable of a class that is not rclpy's.

    After an exception of one of its methods it is not waited for during a pause, because it stays
    ready.
    """

    def __init__(
        self,
        runtime: Runtime,
        waitable: Waitable,
        where: str,
        thread: WaitSetThread,
        executor: Any,
    ) -> None:
        super().__init__(runtime, waitable, waitable, where, thread)
        self._executor = executor
        self._ready = False

    def counts(self) -> tuple[int, int, int, int, int, int]:
        try:
            number = self.entity.get_num_entities()
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._fail_in_thread(error)
            return (0, 0, 0, 0, 0, 0)
        return (
            number.num_subscriptions,
            number.num_guard_conditions,
            number.num_timers,
            number.num_clients,
            number.num_services,
            number.num_events,
        )

    def fill(self, wait_set: Any) -> None:
        if self.parked:
            return
        try:
            self.entity.add_to_wait_set(wait_set)
        except InvalidHandle:
            raise
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._fail_in_thread(error)

    def run_if_ready(self, wait_set: Any) -> None:
        if self.parked:
            return
        try:
            self._ready = self.entity.is_ready(wait_set)
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._retry_later(error)
        if self._ready:
            self._execute()

    def resume(self) -> None:
        if self._ready and not self.closed:
            self._execute()

    def _execute(self) -> None:
        # While parked it may stay ready: waiting for it would keep the thread busy.
        self.parked = self.blocked()
        if self.parked:
            return
        self._ready = False
        waitable = self.entity
        try:
            data = waitable.take_data()
            for future in waitable._futures:
                future._set_executor(self._executor)
            self.run_async(waitable.execute(data))
        except Exception as error:  # noqa: BLE001 - goes to the exception handler
            self._retry_later(error)
        self._thread.refresh()

    def _fail_in_thread(self, error: Exception) -> None:
        self.parked = True
        with suppress(RuntimeError):  # The loop is closed: nothing handles the error.
            self.runtime.loop.call_soon_threadsafe(self._retry_later, error)

    def _retry_later(self, error: Exception) -> None:
        self.runtime.report(error, self.where)
        self.parked = True
        self.runtime.loop.call_later(RETRY_AFTER_FAILED_TAKE_S, self._retry)

    def _retry(self) -> None:
        self.parked = False
        if not self.closed:
            self._thread.refresh()
