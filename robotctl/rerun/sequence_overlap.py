"""Finds where two lists of sequence numbers run side by side."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from operator import lt


def lockstep(ours: Sequence[int], theirs: Sequence[int]) -> tuple[slice, slice] | None:
    """Return the parts of two rising lists that overlap; None if they differ, or do not rise."""
    if not ours or not theirs or not (_rises(ours) and _rises(theirs)):
        return None
    first, last = max(ours[0], theirs[0]), min(ours[-1], theirs[-1])
    parts = _between(ours, first, last), _between(theirs, first, last)
    common = ours[parts[0]]
    return parts if common and common == theirs[parts[1]] else None


def _rises(numbers: Sequence[int]) -> bool:
    return all(map(lt, numbers, numbers[1:]))


def _between(numbers: Sequence[int], first: int, last: int) -> slice:
    return slice(bisect_left(numbers, first), bisect_right(numbers, last))
