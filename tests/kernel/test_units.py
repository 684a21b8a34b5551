"""The units of time are those of the standard library."""

from __future__ import annotations

from datetime import timedelta

from robotctl.kernel.units import DAY_S, NS_PER_S


def test_a_second_and_a_day_have_their_length() -> None:
    assert timedelta(days=1).total_seconds() == DAY_S
    assert timedelta(seconds=1) // timedelta(microseconds=1) * 1000 == NS_PER_S
