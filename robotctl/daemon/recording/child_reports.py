"""The reports of a child process, heard in the loop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from typing import Any

from robotctl.processes import Child


async def reports_of(child: Child) -> AsyncGenerator[dict[str, Any]]:
    """Yield the reports of the child until it closes its pipe.

    Raises:
        ValueError: The child sent something else than JSON objects.
    """
    loop, readable = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(child.fileno(), readable.set)
    try:
        while True:
            await readable.wait()
            readable.clear()
            try:
                said = child.receive(0.0)  # the event may be set for what is read already
            except TimeoutError:
                continue
            except EOFError:
                return
            for each in said:
                yield each
    finally:
        loop.remove_reader(child.fileno())
