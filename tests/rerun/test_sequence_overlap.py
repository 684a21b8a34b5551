"""Two rows of sequence numbers are laid side by side only where they are the same."""

from __future__ import annotations

import pytest

from robotctl.rerun.sequence_overlap import lockstep


@pytest.mark.parametrize(
    ("ours", "theirs", "common"),
    [
        ([1, 2, 3], [1, 2, 3], [1, 2, 3]),
        ([1, 2, 3], [2, 3, 4, 5], [2, 3]),
        ([7], [5, 6, 7], [7]),
        ([2, 4, 8], [1, 2, 4, 8, 9], [2, 4, 8]),
    ],
)
def test_the_common_part_is_found(ours: list[int], theirs: list[int], common: list[int]) -> None:
    for one, other in ((ours, theirs), (theirs, ours)):
        parts = lockstep(one, other)
        assert parts is not None
        assert (one[parts[0]], other[parts[1]]) == (common, common)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ([], [1]),
        ([1, 2], [3, 4]),
        ([1, 3], [1, 2, 3]),
        ([1, 2, 2, 3], [1, 2, 3]),
        ([2, 1], [1, 2]),
        ([1, 5], [2, 4]),
    ],
)
def test_what_differs_or_does_not_rise_has_no_common_part(
    ours: list[int], theirs: list[int]
) -> None:
    assert lockstep(ours, theirs) is None
    assert lockstep(theirs, ours) is None
