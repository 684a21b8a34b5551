"""At the exit no thread of the library is in the midst of a request."""

from __future__ import annotations

import asyncio
import signal
import sys
import threading

import pytest

from robotctl.store.bucket import RequestLoop
from tests.support.waiting import loop_until, until


async def _interrupts_the_wait() -> None:
    main = threading.main_thread().ident
    assert main is not None
    await loop_until(lambda: sys._current_frames()[main].f_code.co_name == "wait")
    signal.pthread_kill(main, signal.SIGINT)
    await asyncio.Event().wait()


async def _answers() -> int:
    return 1


async def _hangs() -> None:
    await asyncio.Event().wait()


@pytest.fixture
def slept() -> list[float]:
    return []


@pytest.fixture
def requests(slept: list[float]) -> RequestLoop:
    return RequestLoop(now_s=lambda: 100.0, sleep=slept.append)


def test_the_exit_waits_for_the_library_also_where_the_request_has_been_cancelled_before(
    requests: RequestLoop, slept: list[float]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        requests.run(_interrupts_the_wait())
    until(lambda: not asyncio.all_tasks(requests.loop))
    requests.end()
    assert slept == [0.5]


def test_the_exit_cancels_what_is_still_under_way(
    requests: RequestLoop, slept: list[float]
) -> None:
    requests.start(_hangs())
    requests.end()
    assert slept == [0.5]


def test_the_exit_waits_for_nothing_after_requests_that_were_answered(
    requests: RequestLoop, slept: list[float]
) -> None:
    assert requests.run(_answers()) == 1
    requests.end()
    assert slept == []
