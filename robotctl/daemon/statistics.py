"""Rates of topics, sampled once a second."""

from __future__ import annotations

from collections.abc import Iterable


class RateMeter:
    """Turns growing counts into rates [1/s] over the time between the last two samples."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}
        self._rates: dict[str, float] = {}
        self._t_ns = 0

    def sample(self, t_ns: int, counts: Iterable[tuple[str, int]]) -> None:
        """Take the counts at steady time `t_ns`."""
        elapsed_s = (t_ns - self._t_ns) / 1e9
        latest = dict(counts)
        self._rates = {
            name: (count - self._counts.get(name, 0)) / elapsed_s for name, count in latest.items()
        }
        self._counts, self._t_ns = latest, t_ns

    def rate(self, name: str) -> float:
        """Return the latest rate, 0 before there is one."""
        return round(self._rates.get(name, 0.0), 2)
