"""Calls that were passed in before the loop runs come before later ones."""

from __future__ import annotations

import threading
from typing import Any

from robotctl.ros.executor.loop_thread import LoopThread

TURN_S = 0.1
"""Time enough for another thread to pass in a call, if nothing hinders it."""


class _Loop:
    """A loop that lets another thread pass in a call after the first of those that were kept."""

    def __init__(self, late: threading.Thread) -> None:
        self._late = late
        self.called: list[object] = []

    def call_soon(self, callback: object) -> None:
        self.called.append(callback)
        if self._late.ident is None:
            self._late.start()
            self._late.join(TURN_S)

    def call_soon_threadsafe(self, callback: object) -> None:
        self.called.append(callback)


def test_a_call_of_another_thread_while_the_loop_is_opened_comes_after_those_kept() -> None:
    calls = LoopThread()
    late = threading.Thread(target=calls.call_soon, args=(bool,))
    loop: Any = _Loop(late)
    calls.call_soon(int)
    calls.call_soon(str)
    calls.open(loop)
    late.join()
    assert loop.called == [int, str, bool]
