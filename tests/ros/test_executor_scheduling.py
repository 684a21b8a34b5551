"""SCHED_FIFO for the loop's thread, where it is permitted."""

from __future__ import annotations

import os
import threading
from typing import Any

import pytest

from robotctl.ros import AsyncioExecutor


async def test_the_executor_says_how_its_thread_is_scheduled_and_undoes_it(context: Any) -> None:
    before = os.sched_getscheduler(0)
    executor = AsyncioExecutor(context, fifo_priority=10)
    async with executor:
        granted = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
        assert executor.scheduling.startswith("SCHED_FIFO 10" if granted else "SCHED_OTHER (")
        policies: list[int] = []
        thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
        assert policies == [os.SCHED_OTHER]
    assert os.sched_getscheduler(0) == before
    assert AsyncioExecutor(context).scheduling == "SCHED_OTHER"


async def test_sched_fifo_refused_by_the_kernel_is_said_and_nothing_else(
    context: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    async with AsyncioExecutor(context, fifo_priority=10) as executor:
        assert "SCHED_FIFO 10 is not permitted" in executor.scheduling


@pytest.mark.parametrize("priority", [0, 100])
def test_a_priority_outside_1_to_99_is_refused(context: Any, priority: int) -> None:
    with pytest.raises(ValueError, match="1 to 99"):
        AsyncioExecutor(context, fifo_priority=priority)
