"""Runs requests in a thread of their own, so that Ctrl-C ends the wait for them at once.

The library has its own threads, and none of its blocking calls can be interrupted. A request that
is still under way when Python ends would make it print a Rust backtrace: at the exit all requests
are cancelled first.
"""

from __future__ import annotations

import asyncio
import atexit
import threading
import time
from collections.abc import Coroutine
from concurrent.futures import Future
from functools import cache
from typing import Any, Final, TypeVar

_Result = TypeVar("_Result")

_LIBRARY_LETS_GO_S: Final = 0.5
"""How long its threads may need after a cancellation, on a busy machine; no call waits for them."""


def run_request(request: Coroutine[Any, Any, _Result]) -> _Result:
    """Return the result of a request, or raise its error; cancel it if the wait is interrupted."""
    started = start_request(request)
    try:
        return started.result()
    except BaseException:
        started.cancel()
        raise


def start_request(request: Coroutine[Any, Any, _Result]) -> Future[_Result]:
    """Start a request, and return its result to come."""
    return asyncio.run_coroutine_threadsafe(request, _loop())


@cache
def _loop() -> asyncio.AbstractEventLoop:
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="store", daemon=True)
    thread.start()
    atexit.register(_end, loop, thread)
    return loop


def _end(loop: asyncio.AbstractEventLoop, thread: threading.Thread) -> None:
    cancelled: list[bool] = []

    def cancel_all() -> None:
        cancelled.extend(task.cancel() for task in asyncio.all_tasks(loop))
        loop.call_soon(loop.stop)

    loop.call_soon_threadsafe(cancel_all)
    thread.join()
    loop.close()
    if cancelled:
        time.sleep(_LIBRARY_LETS_GO_S)
