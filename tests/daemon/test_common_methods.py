"""An answer of many parts holds the loop for one part at a time."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from robotctl.daemon.api.status import common_methods
from robotctl.ipc.method_names import STATUS
from robotctl.ipc.params import NoParams


async def test_the_loop_turns_between_the_parts_of_a_status() -> None:
    done: list[str] = []

    def part(name: str) -> str:
        done.append(name)
        asyncio.get_running_loop().call_soon(done.append, "turn")
        return name

    source: Any = SimpleNamespace(
        stats=lambda: part("counts"), status=lambda stats: part(f"answer from {stats}")
    )
    answer = await common_methods(source, asyncio.Event())[STATUS].handler(NoParams())

    assert answer == "answer from counts"
    assert done == ["counts", "turn", "answer from counts"]
