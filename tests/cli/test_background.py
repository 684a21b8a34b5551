"""A background call ends even if the thread that waits for it is interrupted."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from itertools import count
from types import FrameType
from typing import Any

import pytest

from robotctl.cli.targets.interrupts import Background
from tests.support.waiting import DEADLINE_S, until


def started(work: Callable[[], dict[str, Any]]) -> Background[dict[str, Any]]:
    background = Background(work)
    background.start()
    return background


def test_what_the_work_returns_or_raises_comes_out() -> None:
    def fail() -> dict[str, Any]:
        raise ZeroDivisionError("no")

    assert started(lambda: {"laps": 1}).result() == {"laps": 1}
    with pytest.raises(ZeroDivisionError, match="no"):
        started(fail).result()


def test_the_work_ends_even_if_the_waiting_thread_is_interrupted_at_any_step() -> None:
    for step in count(1):
        release = threading.Event()

        def work(release: threading.Event = release) -> dict[str, Any]:
            release.wait()
            return {}

        working = started(work)

        def is_done(working: Background[dict[str, Any]] = working) -> bool:
            return working.is_done

        was_interrupted = interrupted_at(step, is_done)
        release.set()
        until(is_done)
        working.join(DEADLINE_S)
        assert not working.is_alive()
        if not was_interrupted:
            assert step > 1, "there was no step to interrupt"
            return


def interrupted_at(step: int, ask: Any) -> bool:
    """Call `ask` and interrupt it at a line or a return; return False if it has fewer of them."""
    left = step

    def trace(frame: FrameType, event: str, argument: object) -> Any:
        nonlocal left
        left -= event in ("line", "return")
        if left == 0:
            left = -1
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        ask()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False
