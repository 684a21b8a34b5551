# mypy: disallow-untyped-calls=False
"""Awaiting rclpy's futures in asyncio."""

from __future__ import annotations

import asyncio
import inspect
import time
from collections import Counter
from collections.abc import Callable, Coroutine, Generator, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from rclpy.task import Future

from robotctl.ros.executor.loop_thread import LoopThread
from robotctl.ros.executor.runtime import Runtime, log, name_of

_bridged_loops: Counter[asyncio.AbstractEventLoop] = Counter()
_rclpy_await: Callable[[Future], Generator[Any, None, Any]] = Future.__await__


async def wait(future: Future) -> Any:
    """Return the result of an rclpy Future. Cancelling the wait cancels the future.

    Raises:
        asyncio.CancelledError: The future was cancelled.
        Exception: The exception of the future.
    """
    loop = asyncio.get_running_loop()
    waiter: asyncio.Future[Any] = loop.create_future()

    def settle(_: object = None) -> None:
        if waiter.done():
            return
        if future.cancelled():
            waiter.cancel()
        elif (error := future.exception()) is not None:
            waiter.set_exception(error)
        else:
            waiter.set_result(future.result())

    def settle_in_loop(_: Future) -> None:
        if _running_loop() is loop:
            settle()
        else:
            # In a closed loop nothing waits.
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(settle)

    if future.done() or future.cancelled():
        settle()
    else:
        future.add_done_callback(settle_in_loop)
    try:
        return await waiter
    except asyncio.CancelledError:
        future.remove_done_callback(settle_in_loop)
        future.cancel()
        raise


def open_bridge(loop: asyncio.AbstractEventLoop) -> None:
    """Make `await future` work for rclpy futures in this loop, until `close_bridge` is called."""
    _bridged_loops[loop] += 1
    _set_await(_await_bridged)


def close_bridge(loop: asyncio.AbstractEventLoop) -> None:
    """Undo one call of `open_bridge`."""
    _bridged_loops[loop] -= 1
    if not _bridged_loops[loop]:
        del _bridged_loops[loop]
    if not _bridged_loops:
        _set_await(_rclpy_await)


def _await_bridged(self: Future) -> Generator[Any, None, Any]:
    # rclpy's method is a bare `yield`: in a task, it would keep the loop at 100 % CPU.
    if _running_loop() in _bridged_loops:
        return wait(self).__await__()
    return _rclpy_await(self)


def _set_await(method: Callable[[Future], Generator[Any, None, Any]]) -> None:
    setattr(Future, "__await__", method)  # noqa: B010 - mypy refuses the plain assignment


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None


class ImmediateCallbacks:
    """Stands in for the executor of a future, and runs the done callbacks at once."""

    def __init__(self, report: Callable[[Exception, str], None]) -> None:
        self._report = report

    def create_task(self, callback: Callable[[Future], object], future: Future) -> None:
        """Call `callback(future)` at once. rclpy calls this for each done callback."""
        try:
            callback(future)
        except Exception as error:  # noqa: BLE001 - goes to the handler
            self._report(error, "done callback of a future")


@contextmanager
def callbacks_at_once(
    future: Future, immediate: ImmediateCallbacks, executor: Any
) -> Iterator[None]:
    """Run the done callbacks at once if `future` gets its result within the `with` block.

    After the block, `executor` runs new done callbacks. If it is None, rclpy calls them directly.
    """
    future._set_executor(immediate)
    try:
        yield
    finally:
        future._set_executor(executor)


def fail_pending(
    pending: dict[Any, Future], error: Exception, immediate: ImmediateCallbacks
) -> None:
    """Fail every future of `pending` with `error`, and clear `pending`."""
    for future in list(pending.values()):
        with callbacks_at_once(future, immediate, None):
            future.set_exception(error)
        # Otherwise rclpy prints the exception, if nothing waits for the future.
        future.exception()
    pending.clear()


class ExecutorTask(Future):
    """An rclpy Future whose `cancel` also cancels the running coroutine."""

    def __init__(self, executor: Any, loop_thread: LoopThread) -> None:
        super().__init__(executor=executor)
        self._loop_thread = loop_thread
        self.running: asyncio.Task[None] | None = None
        """The task of the running coroutine. Used in the loop's thread only."""

    def cancel(self) -> None:
        """Cancel the future and its coroutine. Any thread may call this."""
        super().cancel()
        if self.cancelled():
            with suppress(RuntimeError):  # The loop is closed: nothing runs.
                self._loop_thread.call_soon(self._cancel_running)

    def _cancel_running(self) -> None:
        if self.running is not None:
            self.running.cancel()


class Tasks:
    """Runs functions and coroutines in the loop, and sets a future for each.

    An exception goes into the future, and to the exception handler if the future has no done
    callback.
    """

    def __init__(self, executor: Any, loop_thread: LoopThread) -> None:
        self._executor = executor
        self._loop_thread = loop_thread
        self.runtime: Runtime | None = None
        """The runtime of the open executor, None before."""

        self.closed = False
        """Whether the executor is closed. Then tasks that have not begun are cancelled."""

    def create(self, callback: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> ExecutorTask:
        """Run a function, a coroutine function or a coroutine in the loop, and return its future.

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
        if task.cancelled() or self.closed:
            self._settle(task, lambda: Future.cancel(task))
            return
        assert self.runtime is not None
        begun = time.monotonic_ns()
        try:
            result = function(*args, **kwargs)
        except Exception as error:  # noqa: BLE001 - goes into the future
            self._fail(task, error, name_of(function))
            return
        finally:
            self.runtime.slow.check(f"task {name_of(function)}", time.monotonic_ns() - begun)
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

        if task.cancelled() or self.closed:
            finished()
            return
        assert self.runtime is not None
        task.running = self.runtime.spawn(run(), f"task {name_of(coroutine)}", finished)

    def _fail(self, task: ExecutorTask, error: Exception, name: str) -> None:
        has_done_callback = bool(task._callbacks)
        self._settle(task, lambda: task.set_exception(error))
        if not has_done_callback:
            task.exception()  # Fetched: otherwise rclpy prints it as well.
            self._report(error, f"task {name}")

    def _settle(self, task: ExecutorTask, settle: Callable[[], None]) -> None:
        later = None if self.closed else self._executor
        with callbacks_at_once(task, ImmediateCallbacks(self._report), later):
            settle()

    def _report(self, error: Exception, where: str) -> None:
        if self.runtime is not None:
            self.runtime.report(error, where)
        else:
            log.error("exception in the %s", where, exc_info=error)
