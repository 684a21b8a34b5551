"""What is written as a number in JSON is one."""

from __future__ import annotations

from math import inf, nan

import pytest

from robotctl.kernel.codec import finite_or_none


def test_a_number_stays_what_it_is() -> None:
    assert (finite_or_none(1.5), finite_or_none(0.0)) == (1.5, 0.0)


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_what_is_no_number_is_none(value: float) -> None:
    assert finite_or_none(value) is None
