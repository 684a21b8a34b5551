"""Awaiting rclpy's futures in asyncio.

`rclpy.task.Future.__await__` is a bare `yield`: awaited in an asyncio task, it keeps the loop at
100 % CPU until the result is there. While an AsyncioExecutor is open, `await future` in its loop
uses `wait` instead; elsewhere rclpy's own method stays.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from rclpy.task import Future

_bridged_loops: Counter[asyncio.AbstractEventLoop] = Counter()
_rclpy_await: Callable[[Future], Generator[Any, None, Any]] = Future.__await__


async def wait(future: Future) -> Any:
    """Return the result of an rclpy Future; the loop sleeps until then.

    A cancellation cancels the future as well, so that its client forgets the request.

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
    """Let `await future` in this loop use `wait`, until `close_bridge`."""
    _bridged_loops[loop] += 1
    _set_await(_await_bridged)


def close_bridge(loop: asyncio.AbstractEventLoop) -> None:
    """Undo one `open_bridge`; the last one restores rclpy's own method."""
    _bridged_loops[loop] -= 1
    if not _bridged_loops[loop]:
        del _bridged_loops[loop]
    if not _bridged_loops:
        _set_await(_rclpy_await)


def _await_bridged(self: Future) -> Generator[Any, None, Any]:
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
    """An executor for a future that is being set: it runs the done callbacks at once.

    rclpy's futures pass their callbacks to `create_task` of an executor, which would run them a
    turn of the loop later.
    """

    def __init__(self, report: Callable[[Exception, str], None]) -> None:
        self._report = report

    def create_task(self, callback: Callable[[Future], object], future: Future) -> None:
        """Run a done callback of the future."""
        try:
            callback(future)
        except Exception as error:  # noqa: BLE001 - goes to the handler
            self._report(error, "done callback of a future")


@contextmanager
def callbacks_at_once(
    future: Future, immediate: ImmediateCallbacks, executor: Any
) -> Iterator[None]:
    """Let setting the future within the `with` block run its done callbacks at once.

    Afterwards it passes them to `executor`: rclpy would otherwise run a callback that is added
    later under the future's lock.
    """
    future._set_executor(immediate)
    try:
        yield
    finally:
        future._set_executor(executor)


def fail_pending(
    pending: dict[Any, Future], error: Exception, immediate: ImmediateCallbacks
) -> None:
    """Set the error in every future of `pending`, so that all waits end."""
    for future in list(pending.values()):
        with callbacks_at_once(future, immediate, None):
            future.set_exception(error)
        # Fetched: otherwise rclpy prints it where nothing waited for the future.
        future.exception()
    pending.clear()
