"""The beat of the process: what may come a little earlier shares a wake-up of the loop.

A wake-up costs more than most of what is done in it. So tickers of one rate expire together, and
timers whose exact time does not matter expire with them.
"""

from __future__ import annotations

import time

BEAT_NS = 20_000_000
"""The beat of timers that share wake-ups: 50 times a second."""

_START_NS = time.monotonic_ns()
"""The first beat. Each process has its own, so that daemons of one machine take turns."""


def beat_before(t_ns: int, period_ns: int = BEAT_NS) -> int:
    """Return the last beat that is not after the steady time `t_ns` [ns]."""
    return t_ns - (t_ns - _START_NS) % period_ns
