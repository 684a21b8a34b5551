"""The one bridge from rclpy's Future to asyncio.

`rclpy.task.Future.__await__` is a bare `yield`: awaited in an asyncio task it turns the loop at
100 % CPU until the result is there. While an AsyncioExecutor is open, awaiting one *in its loop*
goes through `wait` instead; everywhere else rclpy's own behaviour stays.
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
    """The result of an rclpy Future, awaited without turning the loop.

    Being cancelled cancels the future, which makes its client forget the request.

    Raises:
        asyncio.CancelledError: the future was cancelled.
        Exception: whatever the future holds.
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
            # A closed loop has no waiter left to tell.
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
    """Let `await future` in this loop go through `wait`, until `close_bridge`."""
    _bridged_loops[loop] += 1
    _set_await(_await_bridged)


def close_bridge(loop: asyncio.AbstractEventLoop) -> None:
    """Undo one `open_bridge`; with the last one rclpy's own method comes back."""
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


class CallbacksNow:
    """Stands in for an executor while a future is resolved: runs done callbacks at once.

    rclpy's futures hand their callbacks to an executor's `create_task`, which would cost a turn
    of the loop a response.
    """

    def __init__(self, report: Callable[[Exception, str], None]) -> None:
        self._report = report

    def create_task(self, callback: Callable[[Future], object], future: Future) -> None:
        """Run one done callback of the future."""
        try:
            callback(future)
        except Exception as error:  # noqa: BLE001 - handed to the executor's one handler
            self._report(error, "done callback of a future")


@contextmanager
def callbacks_at_once(future: Future, now: CallbacksNow, executor: Any) -> Iterator[None]:
    """While inside, resolving the future runs its callbacks; later ones go to the executor.

    Not for longer: rclpy would run a later one under the future's lock.
    """
    future._set_executor(now)
    try:
        yield
    finally:
        future._set_executor(executor)


def fail_pending(pending: dict[Any, Future], error: Exception, now: CallbacksNow) -> None:
    """Give every future of `pending` the error, so that nobody waits for ever."""
    for future in list(pending.values()):
        with callbacks_at_once(future, now, None):
            future.set_exception(error)
        # Fetched here: otherwise rclpy prints it where nobody waited for this one.
        future.exception()
    pending.clear()
