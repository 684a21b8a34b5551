"""Wait in the loop for a condition, with a deadline."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

POLL_S = 0.01

DISCOVERY_S = 4.0
"""Fast DDS usually discovers a process on the same machine within 0.15 s, at worst within 2.6 s."""


async def until(condition: Callable[[], bool], deadline_s: float) -> bool:
    """Wait until the condition holds, for `deadline_s` seconds at most; return whether it holds."""
    end = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > end:
            return False
        await asyncio.sleep(POLL_S)
    return True
