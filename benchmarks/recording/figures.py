"""What is measured, what is to be reached, and the table that says both."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

Round = Mapping[str, float]
"""What one round of a part measured: value by name."""


@dataclass(frozen=True)
class Figure:
    """A line of the table: the value of that name, and its limit (None: only told)."""

    name: str
    limit: float | None = None
    at_least: bool = False
    digits: str = ".2f"

    def target(self) -> str:
        """What is to be reached, in words."""
        if self.limit is None:
            return ""
        return f"{'>=' if self.at_least else '<='} {self.limit:,g}"

    def reached(self, value: float) -> bool:
        """Whether the value is as good as it is to be."""
        if self.limit is None:
            return True
        return value >= self.limit if self.at_least else value <= self.limit


def spread(values: Sequence[float], digits: str) -> str:
    """Median [lowest .. highest]; the value alone where there is one."""
    middle = f"{statistics.median(values):,{digits}}"
    if len(values) == 1:
        return middle
    return f"{middle} [{min(values):,{digits}} .. {max(values):,{digits}}]"


def table(figures: Iterable[Figure], rounds: Sequence[Round]) -> tuple[list[str], int]:
    """Lines of a Markdown table, and how many figures were missed."""
    lines, missed = [], 0
    for figure in figures:
        values = [each[figure.name] for each in rounds]
        reached = figure.reached(statistics.median(values))
        missed += not reached
        verdict = "" if figure.limit is None else "reached" if reached else "MISSED"
        measured = spread(values, figure.digits)
        lines.append(f"| {figure.name:58} | {figure.target():>9} | {measured:34} | {verdict:7} |")
    return lines, missed
