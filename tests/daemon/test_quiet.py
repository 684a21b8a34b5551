"""A daemon with a quiet robot uses little CPU time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from typing import Any

import pytest

from robotctl.ros.executor.runtime import Pool

LOOKS_PER_S = 100
"""Limit of the polls of the recorder's topics: a rest of one beat makes 50, of 2 ms 200."""


async def test_the_recorder_of_a_quiet_robot_looks_seldom(
    in_process: Callable[..., AbstractAsyncContextManager[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = 0
    loop = asyncio.get_running_loop()
    call_at = loop.call_at

    def counted(at_s: float, callback: Any, *arguments: Any, **named: Any) -> asyncio.TimerHandle:
        """A pool rests after each look."""
        nonlocal looks
        looks += isinstance(getattr(callback, "__self__", None), Pool)
        return call_at(at_s, callback, *arguments, **named)

    monkeypatch.setattr(loop, "call_at", counted)
    async with in_process() as daemon:
        await daemon.until(lambda status: status["recorder"]["received"] > 200)
        looks, begun = 0, time.monotonic()
        await asyncio.sleep(2.0)
        rate = looks / (time.monotonic() - begun)
    assert 0 < rate <= LOOKS_PER_S
