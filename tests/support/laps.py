"""Laps of plain patterns."""

from __future__ import annotations

from robotctl.kernel.course import PLAIN
from robotctl.kernel.path import Path
from robotctl.kernel.patterns import Pattern, PatternKind, path_of


def lap_of(kind: PatternKind, size_m: float) -> Path:
    """Return one lap of a plain pattern."""
    return path_of(Pattern(kind, size_m), PLAIN)
