"""Numbers that may be unknown: NaN in the kernel, None in JSON."""

from __future__ import annotations

from math import isfinite


def finite_or_none(value: float) -> float | None:
    """Return a number, None if it is NaN or infinite."""
    return value if isfinite(value) else None
