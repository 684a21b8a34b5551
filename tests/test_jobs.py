"""The reports of a child are heard without ever blocking the loop."""

from __future__ import annotations

import asyncio
import os
from threading import Timer

from robotctl.processes import Child
from robotctl.processes.jobs import reports_of


async def test_a_child_that_lives_on_after_a_report_does_not_hold_up_the_loop() -> None:
    reading, writing = os.pipe()
    closed_by: list[str] = []

    def close(by: str) -> None:
        if not closed_by:
            closed_by.append(by)
            os.close(writing)

    guard = Timer(5.0, close, ["the guard"])  # ends a read that blocks
    guard.start()
    asyncio.get_running_loop().call_later(0.1, close, "the loop")
    os.write(writing, b'{"text": "first"}\n')
    child = Child(os.getpid(), reading, None)
    try:
        assert [said async for said in reports_of(child)] == [{"text": "first"}]
    finally:
        guard.cancel()
        child.detach()
    assert closed_by == ["the loop"]
