"""Warnings about callbacks that hold the loop too long."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Coroutine, Generator
from typing import Any

from robotctl.ros.executor.time_limits import SLOW_CALLBACK_NS, SLOW_WARNING_PAUSE_NS

_log = logging.getLogger("robotctl.ros.executor")


class SlowCallbacks:
    """Warns about callbacks that hold the loop, at most once per SLOW_WARNING_PAUSE_NS for each."""

    def __init__(self) -> None:
        self._quiet_until_ns: dict[str, int] = {}
        self._unsaid: Counter[str] = Counter()

    def check(self, where: str, elapsed_ns: int) -> None:
        """Warn about a callback if it held the loop for more than SLOW_CALLBACK_NS."""
        if elapsed_ns > SLOW_CALLBACK_NS:
            self._warn(where, elapsed_ns)

    def _warn(self, where: str, elapsed_ns: int) -> None:
        now = time.monotonic_ns()
        if now < self._quiet_until_ns.get(where, 0):
            self._unsaid[where] += 1
            return
        for name in [name for name, until in self._quiet_until_ns.items() if until < now]:
            del self._quiet_until_ns[name]
        self._quiet_until_ns[where] = now + SLOW_WARNING_PAUSE_NS
        unsaid = self._unsaid.pop(where, 0)
        _log.warning(
            "the callback of %s held the loop for %.0f ms%s; everything else waited. "
            "Make it async, or run the long part with asyncio.to_thread",
            where,
            elapsed_ns / 1e6,
            f" (and {unsaid} times since the last warning)" if unsaid else "",
        )


class TimedSteps:
    """Awaits a coroutine; warns about each step between two awaits that holds the loop too long."""

    __slots__ = ("_coroutine", "_slow", "_where")

    def __init__(
        self, coroutine: Coroutine[Any, Any, Any], where: str, slow: SlowCallbacks
    ) -> None:
        self._coroutine = coroutine
        self._where = where
        self._slow = slow

    def __await__(self) -> Generator[Any, Any, Any]:
        coroutine = self._coroutine
        sent: Any = None
        thrown: BaseException | None = None
        while True:
            begun = time.monotonic_ns()
            try:
                waited = coroutine.send(sent) if thrown is None else coroutine.throw(thrown)
            except StopIteration as stop:
                return stop.value
            finally:
                self._slow.check(self._where, time.monotonic_ns() - begun)
            sent, thrown = None, None
            try:
                sent = yield waited
            except GeneratorExit:
                coroutine.close()
                raise
            except BaseException as error:  # noqa: BLE001 - cancellation goes to the coroutine too
                thrown = error
