# mypy: disallow-untyped-calls=False
"""The tasks that `create_task` starts, and the futures that it returns."""

from __future__ import annotations

import asyncio
import inspect
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

from rclpy.task import Future

from robotctl.ros.executor.futures import ImmediateCallbacks, callbacks_at_once
from robotctl.ros.executor.loop_thread import LoopThread
from robotctl.ros.executor.runtime import Runtime, log, name_of


class ExecutorTask(Future):
    """An rclpy Future whose `cancel` also cancels the running coroutine."""

    def __init__(self, executor: Any, loop_thread: LoopThread) -> None:
        super().__init__(executor=executor)
        self._loop_thread = loop_thread
        self.running: asyncio.Task[None] | None = None
        """The task of the coroutine once it has started; used in the loop's thread only."""

    def cancel(self) -> None:
        """Cancel the future and its coroutine; may be called from any thread."""
        super().cancel()
        if self.cancelled():
            with suppress(RuntimeError):  # The loop is closed: nothing runs.
                self._loop_thread.call_soon(self._cancel_running)

    def _cancel_running(self) -> None:
        if self.running is not None:
            self.running.cancel()


class Tasks:
    """Runs functions and coroutines in the loop, and sets the future of each.

    An exception goes into the future, and to the exception handler as well unless the future has
    a done callback.
    """

    def __init__(self, executor: Any, loop_thread: LoopThread) -> None:
        self._executor = executor
        self._loop_thread = loop_thread
        self._runtime: Runtime | None = None
        self._closed = False

    def open(self, runtime: Runtime) -> None:
        """Begin to run tasks in the loop of `runtime`."""
        self._runtime = runtime

    def close(self) -> None:
        """Cancel the tasks that have not begun."""
        self._closed = True

    def create(self, callback: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> ExecutorTask:
        """Run a function, a coroutine function or a coroutine in the loop, soon.

        Raises:
            RuntimeError: The loop is closed.
        """
        task = ExecutorTask(self._executor, self._loop_thread)
        if inspect.iscoroutine(callback):
            self._loop_thread.call_soon(lambda: self._run_coroutine(task, callback))
        else:
            self._loop_thread.call_soon(lambda: self._run_function(task, callback, args, kwargs))
        return task

    def _run_function(
        self, task: ExecutorTask, function: Any, args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> None:
        if task.cancelled() or self._closed:
            self._settle(task, lambda: Future.cancel(task))
            return
        assert self._runtime is not None
        begun = time.monotonic_ns()
        try:
            result = function(*args, **kwargs)
        except Exception as error:  # noqa: BLE001 - goes into the future
            self._fail(task, error, name_of(function))
            return
        finally:
            self._runtime.slow.check(f"task {name_of(function)}", time.monotonic_ns() - begun)
        if inspect.iscoroutine(result):
            self._run_coroutine(task, result)
        else:
            self._settle(task, lambda: task.set_result(result))

    def _run_coroutine(self, task: ExecutorTask, coroutine: Coroutine[Any, Any, Any]) -> None:
        async def run() -> None:
            try:
                result = await coroutine
            except Exception as error:  # noqa: BLE001 - goes into the future
                self._fail(task, error, name_of(coroutine))
            else:
                self._settle(task, lambda: task.set_result(result))

        def finished() -> None:
            coroutine.close()
            if not task.done():
                self._settle(task, lambda: Future.cancel(task))

        if task.cancelled() or self._closed:
            finished()
            return
        assert self._runtime is not None
        task.running = self._runtime.spawn(run(), f"task {name_of(coroutine)}", finished)

    def _fail(self, task: ExecutorTask, error: Exception, name: str) -> None:
        has_done_callback = bool(task._callbacks)
        self._settle(task, lambda: task.set_exception(error))
        if not has_done_callback:
            task.exception()  # Fetched: otherwise rclpy prints it as well.
            self._report(error, f"task {name}")

    def _settle(self, task: ExecutorTask, settle: Callable[[], None]) -> None:
        later = None if self._closed else self._executor
        with callbacks_at_once(task, ImmediateCallbacks(self._report), later):
            settle()

    def _report(self, error: Exception, where: str) -> None:
        if self._runtime is not None:
            self._runtime.report(error, where)
        else:
            log.error("exception in the %s", where, exc_info=error)
