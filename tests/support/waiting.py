"""Waiting for a condition, on a machine that may be slow."""

from __future__ import annotations

import asyncio
import faulthandler
import time
from collections.abc import Callable, Sized
from typing import Final, TypeVar

T = TypeVar("T")

DEADLINE_S: Final = 60.0
"""A wait that takes this long has failed: every condition should hold far sooner."""


def until(condition: Callable[[], T]) -> T:
    """Poll a condition, and return its first true result; fail after DEADLINE_S."""
    end = time.monotonic() + DEADLINE_S
    pause_s = 0.005
    while not (answer := condition()):
        if time.monotonic() > end:
            faulthandler.dump_traceback(2)
            raise AssertionError("waited in vain")
        time.sleep(pause_s)
        pause_s = min(1.2 * pause_s, 0.05)  # a long wait leaves the machine to others
    return answer


def until_longer(items: Sized, count: int) -> None:
    """Wait until there are more than `count` items."""
    until(lambda: len(items) > count)


async def loop_until(condition: Callable[[], object]) -> None:
    """Wait for a condition while the asyncio loop runs; fail after DEADLINE_S."""
    async with asyncio.timeout(DEADLINE_S):
        while not condition():  # noqa: ASYNC110 - whatever the condition is
            await asyncio.sleep(0.005)
