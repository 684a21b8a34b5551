"""Figures with their limits, and the table of the measured values."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

Round = Mapping[str, float]
"""The values that one round measured, by the name of the figure."""


@dataclass(frozen=True)
class Figure:
    """A line of the table: the value with this `name`, and its limit (None: not judged)."""

    name: str
    limit: float | None = None
    at_least: bool = False
    digits: str = ".2f"

    def target(self) -> str:
        """Return the limit as text, such as `<= 20`; "" without a limit."""
        if self.limit is None:
            return ""
        return f"{'>=' if self.at_least else '<='} {self.limit:,g}"

    def reached(self, value: float) -> bool:
        """Return whether the value is within the limit."""
        if self.limit is None:
            return True
        return value >= self.limit if self.at_least else value <= self.limit


def spread(values: Sequence[float], digits: str) -> str:
    """Return `MEDIAN [LOWEST .. HIGHEST]` as text, or a single value alone."""
    middle = f"{statistics.median(values):,{digits}}"
    if len(values) == 1:
        return middle
    return f"{middle} [{min(values):,{digits}} .. {max(values):,{digits}}]"


def table(figures: Iterable[Figure], rounds: Sequence[Round]) -> tuple[list[str], int]:
    """Return the lines of a Markdown table, and how many figures missed their limit."""
    lines, missed = [], 0
    for figure in figures:
        values = [each[figure.name] for each in rounds]
        reached = figure.reached(statistics.median(values))
        missed += not reached
        verdict = "" if figure.limit is None else "reached" if reached else "MISSED"
        measured = spread(values, figure.digits)
        lines.append(f"| {figure.name:58} | {figure.target():>9} | {measured:34} | {verdict:7} |")
    return lines, missed
