"""The ledger counts exactly the messages that were sent and not received."""

from __future__ import annotations

import random
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from robotctl.recording.format.names import LEDGER_RECORD
from robotctl.recording.format.topics import (
    COUNTERS,
    Topic,
    TopicStats,
    by_topic,
    ledger_values,
    read_ledger,
    total,
)
from robotctl.recording.write.channel_state import MAX_PUBLISHERS, ChannelState, SequenceGaps


def feed(ledger: SequenceGaps, gid: bytes, *sequences: int) -> None:
    """Feed sequence numbers as the recorder does: advance the expected one, else call `note`."""
    for sequence in sequences:
        if ledger.expected.get(gid) == sequence:
            ledger.expected[gid] = sequence + 1
        else:
            ledger.note(gid, sequence)


def test_a_gap_counts_its_messages() -> None:
    ledger = SequenceGaps()
    feed(ledger, b"a", 1, 2, 5, 6, 10)
    assert (ledger.lost, ledger.unseen) == (2 + 3, 0)


def test_what_was_sent_before_the_first_message_received_is_not_called_lost() -> None:
    ledger = SequenceGaps()
    feed(ledger, b"a", 101, 102)
    assert (ledger.lost, ledger.unseen) == (0, 100)


def test_each_publisher_counts_for_itself() -> None:
    ledger = SequenceGaps()
    feed(ledger, b"a", 1, 2)
    feed(ledger, b"b", 1, 2, 3)
    feed(ledger, b"a", 3, 4)
    feed(ledger, b"b", 5)
    assert ledger.lost == 1


def test_a_publisher_that_restarts_loses_nothing_by_it() -> None:
    ledger = SequenceGaps()
    feed(ledger, b"a", *range(1, 500), *range(1, 300), 301)
    assert ledger.lost == 1


def test_a_message_that_comes_late_is_not_lost() -> None:
    ledger = SequenceGaps()
    feed(ledger, b"a", 1, 2, 5, 3, 6, 4, 7)
    assert ledger.lost == 0


def test_a_publisher_that_does_not_count_loses_nothing() -> None:
    ledger = SequenceGaps()
    feed(ledger, b"a", 0, 0, 0)
    assert (ledger.lost, ledger.unseen, ledger.expected) == (0, 0, {})


def test_latched_messages_that_are_delivered_again_lose_nothing() -> None:
    ledger = SequenceGaps()
    feed(ledger, b"a", 1, 2, 3, 3, 4)
    feed(ledger, b"a", 2, 3, 4, 5)
    assert ledger.lost == 0


def test_publishers_that_keep_restarting_need_bounded_memory() -> None:
    ledger = SequenceGaps()
    for number in range(3 * MAX_PUBLISHERS):
        feed(ledger, number.to_bytes(4, "big"), 1, 3)
    assert len(ledger.expected) == len(ledger._missing) == MAX_PUBLISHERS
    assert ledger.lost == 3 * MAX_PUBLISHERS


@given(st.integers(1, 300), st.floats(0, 0.9), st.randoms(use_true_random=False))
def test_lost_is_exactly_what_lies_between_the_received_ones(
    count: int, loss: float, dice: random.Random
) -> None:
    received = [number for number in range(1, count + 1) if dice.random() >= loss]
    ledger = SequenceGaps()
    feed(ledger, b"a", *received)
    if received:
        assert ledger.unseen == received[0] - 1
        assert ledger.lost == received[-1] - received[0] + 1 - len(received)


def stats(name: str, type_name: str, **counts: Any) -> TopicStats:
    return TopicStats(name=name, type_name=type_name, **counts)


def test_a_topic_that_was_recorded_anew_is_one_topic_unless_its_type_changed() -> None:
    channels = [
        stats("/b", "t", received=3, written=2, queued=1, bytes=30),
        stats("/a", "t", received=1),
        stats("/b", "t", received=4, written=4, lost=2, bytes=40),
        stats("/b", "other", received=5),
    ]
    assert by_topic(channels) == [
        stats("/b", "t", received=7, written=6, queued=1, lost=2, bytes=70),
        stats("/a", "t", received=1),
        stats("/b", "other", received=5),
    ]


def test_every_counter_is_summed_and_recorded() -> None:
    numbers = {name: 10 + each for each, name in enumerate(COUNTERS)}
    (twice,) = by_topic([stats("/a", "t", **numbers), stats("/a", "t", **numbers)])
    assert total([twice]) == {name: 2 * number for name, number in numbers.items()}
    told = read_ledger({LEDGER_RECORD: ledger_values([twice])})
    assert told == {"/a": {**total([twice]), "bytes": 0}}


def test_the_record_names_the_second_type_of_a_topic() -> None:
    topics = [stats("/scan", "a/msg/A", received=1), stats("/scan", "b/msg/B", received=10)]
    told = read_ledger({LEDGER_RECORD: ledger_values(topics)})
    assert {name: counts["received"] for name, counts in told.items()} == {
        "/scan": 1,
        "/scan (b/msg/B)": 10,
    }


def test_a_latched_message_without_memory_gives_back_the_room_of_the_one_before() -> None:
    class Endless(bytes):
        def __bytes__(self) -> bytes:
            raise MemoryError

    channel = ChannelState(Topic("/map", "a/msg/A", offered_qos="durability: transient_local"))
    assert channel.keep_latched(b"gid", bytes(100), 0, 0, 0, 1000) == 100
    assert channel.keep_latched(b"gid", Endless(10), 0, 0, 1, 900) == -100
    assert (channel.latched_messages(), channel.not_kept) == ([], 1)
