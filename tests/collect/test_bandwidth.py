"""The limit of the bandwidth, on a clock of the test."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from robotctl.collect.bandwidth import BURST_S, Bandwidth

PIECES = st.lists(st.tuples(st.integers(1, 10**6), st.floats(0, 5)), min_size=1, max_size=50)


@given(PIECES, st.floats(1e3, 1e9))
def test_no_more_leaves_than_the_limit_allows(
    pieces: list[tuple[int, float]], bytes_per_s: float
) -> None:
    now_s = begun_s = 100.0
    limit, sent = Bandwidth(bytes_per_s, now_s), 0
    for count, idle_s in pieces:
        now_s += limit.delay_s(count, now_s)
        sent += count
        assert sent / bytes_per_s <= now_s - begun_s + BURST_S + 1e-3
        now_s += idle_s


def test_a_sender_that_always_has_more_reaches_the_limit() -> None:
    limit, now_s = Bandwidth(1000.0, 0.0), 0.0
    for _ in range(100):
        now_s += limit.delay_s(100, now_s)
    assert abs(now_s - 10.0) <= BURST_S


def test_a_pause_is_not_made_up_for() -> None:
    limit = Bandwidth(1000.0, 0.0)
    an_hour_later_s = 3600.0
    waited_s = sum(limit.delay_s(1000, an_hour_later_s) for _ in range(2))
    assert waited_s >= 2 - 2 * BURST_S
