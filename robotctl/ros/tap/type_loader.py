"""Loads the types of topics in threads, because each takes tens of milliseconds."""

from __future__ import annotations

import asyncio
import threading
import time
from contextlib import suppress

from rclpy.type_support import check_for_type_support

from robotctl.messages.installed import UnusableType, installed_type, parse_type_name
from robotctl.ros.messages.classes import message_class

SLOW_LOAD_S = 2.0
"""A load that takes longer is slow: the next one does not wait for it. Most take 0.1 s."""

MAX_LOADS = 4
"""Limit on simultaneous loads. Another one begins only if all running ones are slow, because each
competes with the loop for the GIL."""

MAX_REMEMBERED = 4096
"""Limit on remembered results; other processes may announce any number of types."""


class TypeLoader:
    """Loads types in daemon threads; used in the loop's thread only.

    Any exception that a module raises is the reason why its type cannot be loaded. A load that
    never ends does not keep the process alive.
    """

    def __init__(self) -> None:
        self._problems: dict[str, str] = {}
        """Type -> why it cannot be loaded, or "" if it is loaded."""

        self._waiting: dict[str, None] = {}
        self._loading: dict[str, float] = {}
        """Type -> when its load began, on the steady clock [s]."""

        self._all_loaded = asyncio.Event()

    def problem(self, type_name: str) -> str | None:
        """Return why a type cannot be loaded, "" if it is loaded, None while it is loading.

        The reason continues the words "type T, which". The first call for a type starts its load.
        """
        known = self._problems.get(type_name)
        if known is not None:
            return known
        if type_name not in self._waiting and type_name not in self._loading:
            try:
                parse_type_name(type_name)
            except UnusableType as error:
                return str(error)
            self._waiting[type_name] = None
        self._load_next()
        return self._problems.get(type_name)

    def is_slow(self, type_name: str) -> bool:
        """Return whether a type has been loading for more than SLOW_LOAD_S."""
        since_s = self._loading.get(type_name)
        return since_s is not None and time.monotonic() - since_s > SLOW_LOAD_S

    async def pause(self, at_most_s: float) -> None:
        """Sleep for `at_most_s` seconds; end early when a load ends and no type is left to load."""
        self._all_loaded.clear()
        with suppress(TimeoutError):
            async with asyncio.timeout(at_most_s):
                await self._all_loaded.wait()

    def _load_next(self) -> None:
        loop = asyncio.get_running_loop()
        while self._waiting and self._is_free():
            type_name = next(iter(self._waiting))
            del self._waiting[type_name]
            thread = threading.Thread(
                target=self._load, args=(loop, type_name), name="message type", daemon=True
            )
            try:
                thread.start()
            except RuntimeError as error:  # the limit on threads is reached
                self._remember(type_name, f"cannot be loaded ({error})")
            else:
                self._loading[type_name] = time.monotonic()

    def _is_free(self) -> bool:
        return len(self._loading) < MAX_LOADS and all(map(self.is_slow, self._loading))

    def _load(self, loop: asyncio.AbstractEventLoop, type_name: str) -> None:
        problem = load_type(type_name)
        with suppress(RuntimeError):  # the loop is closed: nothing waits for the type
            loop.call_soon_threadsafe(self._loaded, type_name, problem)

    def _loaded(self, type_name: str, problem: str) -> None:
        del self._loading[type_name]
        self._remember(type_name, problem)
        self._load_next()
        if not self._waiting:
            self._all_loaded.set()

    def _remember(self, type_name: str, problem: str) -> None:
        if len(self._problems) >= MAX_REMEMBERED:
            del self._problems[next(iter(self._problems))]
        self._problems[type_name] = problem


def load_type(type_name: str) -> str:
    """Load what a subscription needs of a type; return why the type cannot be loaded, or ""."""
    try:
        check_for_type_support(message_class(type_name))
        installed_type(type_name)
    except UnusableType as error:
        return str(error)
    except BaseException as error:  # noqa: BLE001 - also SystemExit: foreign modules run here
        return f"cannot be loaded ({type(error).__name__}: {error})"
    return ""
