"""Each message reaches the sink once, in whatever order two subscriptions deliver."""

from __future__ import annotations

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from robotctl.ros.tap.subscription import MAX_PUBLISHERS, LatchedMerge


class Got:
    """A merge and the numbers that reached its sink."""

    def __init__(self) -> None:
        self.got: list[tuple[bytes, int]] = []
        self.merge = LatchedMerge(
            lambda data, received_ns, source_ns, sequence, gid: self.got.append((gid, sequence))
        )

    def live(self, sequence: int, gid: bytes = b"one") -> None:
        self.merge.live(b"", 0, 0, sequence, gid)

    def latched(self, sequence: int, gid: bytes = b"one") -> None:
        self.merge.latched(b"", 0, 0, sequence, gid)

    @property
    def sequences(self) -> list[int]:
        return sorted(sequence for _, sequence in self.got)


@given(st.integers(1, 9), st.integers(1, 9), st.integers(10, 20), st.integers())
def test_each_message_is_handed_on_once(
    first_latched: int, first_live: int, last: int, seed: int
) -> None:
    dice, merged = Random(seed), Got()
    live, latched = list(range(first_live, last + 1)), list(range(first_latched, last + 1))
    while live or latched:
        if not latched or (live and dice.random() < 0.5):
            merged.live(live.pop(0))
        else:
            merged.latched(latched.pop(0))
    assert merged.sequences == list(range(min(first_latched, first_live), last + 1))


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3), st.integers(0, 4)), max_size=8))
def test_what_is_latched_is_handed_on_once_however_often_it_is_subscribed_to(
    phases: list[tuple[bool, int, int]],
) -> None:
    merged, sent = Got(), 1
    for mixed, depth, more in phases:
        merged.merge.restart()
        for sequence in range(max(1, sent - depth), sent + 1):
            merged.latched(sequence)
        for _ in range(more):
            sent += 1
            if mixed:
                merged.live(sent)
            merged.latched(sent)
    assert merged.sequences == (list(range(1, sent + 1)) if phases else [])


def test_what_a_publisher_repeats_that_was_lost_and_found_is_handed_on_once() -> None:
    merged = Got()
    for sequence in (1, 2, 3, 2, 3, 4):  # the same subscription: this process did not notice
        merged.latched(sequence)
    assert merged.sequences == [1, 2, 3, 4]


def test_a_publisher_that_does_not_count_is_heard() -> None:
    merged = Got()
    merged.latched(0)
    merged.latched(0)
    assert merged.sequences == [0, 0]


def test_publishers_are_told_apart() -> None:
    merged = Got()
    merged.latched(1, b"latching")
    merged.live(1, b"other")
    merged.live(1, b"latching")
    assert merged.got == [(b"latching", 1), (b"other", 1)]


def test_publishers_that_keep_restarting_take_no_more_than_so_much_memory() -> None:
    merged = Got()
    for number in range(2 * MAX_PUBLISHERS):
        merged.latched(1, number.to_bytes(16, "big"))
    assert len(merged.got) == 2 * MAX_PUBLISHERS
    assert len(merged.merge._latched) == MAX_PUBLISHERS
