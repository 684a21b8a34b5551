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
from collections.abc import Callable, Coroutine
from concurrent.futures import Future
from functools import cache
from math import inf
from typing import Any, Final, TypeVar

_Result = TypeVar("_Result")

_LIBRARY_LETS_GO_S: Final = 0.5
"""How long its threads may need after a cancellation, on a busy machine; no call waits for them."""


class RequestLoop:
    """An asyncio loop in a thread of its own; call `end` when Python ends."""

    def __init__(
        self,
        now_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._now_s = now_s
        self._sleep = sleep
        self._cancelled_s = -inf
        """When a request was last cancelled."""

        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self.loop.run_forever, name="store", daemon=True)
        self._thread.start()

    def start(self, request: Coroutine[Any, Any, _Result]) -> Future[_Result]:
        """Start a request, and return its result to come."""
        return asyncio.run_coroutine_threadsafe(request, self.loop)

    def run(self, request: Coroutine[Any, Any, _Result]) -> _Result:
        """Return the result of a request, or raise its error; cancel it if Ctrl-C comes."""
        started = self.start(request)
        try:
            return started.result()
        except BaseException:
            if started.cancel():
                self._cancelled_s = self._now_s()
            raise

    def end(self) -> None:
        """Cancel all requests, end the thread, and wait until the library has let go."""

        def cancel_all() -> None:
            for task in asyncio.all_tasks(self.loop):
                task.cancel()
                self._cancelled_s = self._now_s()
            self.loop.call_soon(self.loop.stop)

        self.loop.call_soon_threadsafe(cancel_all)
        self._thread.join()
        self.loop.close()
        left_s = self._cancelled_s + _LIBRARY_LETS_GO_S - self._now_s()
        if left_s > 0.0:
            self._sleep(left_s)


@cache
def requests() -> RequestLoop:
    """Return the loop of this process; it is made when it is first needed."""
    loop = RequestLoop()
    atexit.register(loop.end)
    return loop
