"""A limit of the bytes per second, on any clock."""

from __future__ import annotations

from typing import Final

BURST_S: Final = 0.5
"""How much may be sent at once after a pause."""


class Bandwidth:
    """Tells how long to wait before more is sent. Clock in seconds."""

    def __init__(self, bytes_per_s: float, now_s: float) -> None:
        self._bytes_per_s = bytes_per_s
        self._free_s = now_s
        """When all that was sent would have left at the limit."""

    def delay_s(self, count: int, now_s: float) -> float:
        """Note that `count` bytes are about to be sent, and return how long to wait before that."""
        self._free_s = max(self._free_s, now_s - BURST_S) + count / self._bytes_per_s
        return max(0.0, self._free_s - now_s)
