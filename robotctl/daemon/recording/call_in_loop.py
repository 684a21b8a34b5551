"""Calls from other threads into the loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any


def in_loop(call: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a function for any thread that schedules `call` in the running loop."""
    loop = asyncio.get_running_loop()

    def post(argument: Any) -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(call, argument)

    return post
