"""The player keeps an absolute schedule, and reads ahead within limits."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator

import pytest

from robotctl.recording import Message
from robotctl.replay.player import LEAD_NS, Lateness, Player, SteadyClock
from robotctl.replay.timeline import (
    AHEAD_ENTRIES,
    BATCH_ENTRIES,
    MIN_PASS_NS,
    Entry,
    ReadAhead,
    Span,
    entries,
)

MS = 1_000_000


class HandClock:
    """A clock that only sleeping advances, and each sent message by `cost_ns`."""

    def __init__(self) -> None:
        self.time_ns = 5 * MS
        self.slept: list[int] = []

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until(self, moment_ns: int) -> None:
        self.slept.append(moment_ns)
        self.time_ns = max(self.time_ns, moment_ns)


def play(
    timeline: list[Entry], *, rate: float | None = 1.0, cost_ns: int = 0, sends: bool = True
) -> tuple[list[tuple[int, bytes]], Player]:
    """Return what was sent, and when, relative to the start of the schedule."""
    clock = HandClock()
    start_ns = clock.time_ns + LEAD_NS
    sent: list[tuple[int, bytes]] = []

    def send(data: bytes) -> bool:
        sent.append((clock.time_ns - start_ns, data))
        clock.time_ns += cost_ns
        return sends

    player = Player([timeline], {"/a": send}, rate=rate, clock=clock)
    player.run()
    return sent, player


def test_each_message_is_sent_at_its_own_moment_of_the_schedule() -> None:
    timeline = [(at * MS, "/a", bytes([at])) for at in (0, 3, 10, 200)]
    assert play(timeline)[0] == [(at, data) for at, _, data in timeline]
    assert play(timeline, rate=2.0)[0] == [(at // 2, data) for at, _, data in timeline]


def test_a_late_message_delays_none_that_has_time() -> None:
    timeline = [(at * MS, "/a", b"") for at in (0, 1, 2, 50)]
    sent, player = play(timeline, cost_ns=10 * MS)
    assert [at for at, _ in sent] == [0, 10 * MS, 20 * MS, 50 * MS]
    assert player.lateness.max_ns == 18 * MS


def test_at_full_speed_nobody_sleeps_and_no_lateness_is_claimed() -> None:
    sent, player = play([(at * MS, "/a", b"") for at in (0, 500)], rate=None)
    assert len(sent) == 2
    assert player.lateness.count == 0


def test_what_the_middleware_does_not_take_is_counted_apart() -> None:
    _, player = play([(0, "/a", b"")], sends=False)
    assert (player.topics["/a"].sent, player.topics["/a"].failed) == (0, 1)


def test_a_stop_ends_a_long_wait_at_once() -> None:
    waiting = threading.Event()

    def batches() -> Iterator[list[Entry]]:
        waiting.set()
        yield [(3600 * 1000 * MS, "/a", b"")]

    player = Player(batches(), {"/a": lambda _: True}, rate=1.0, clock=SteadyClock())
    thread = threading.Thread(target=player.run)
    thread.start()
    waiting.wait()
    player.stop()
    thread.join(20.0)
    assert not thread.is_alive()
    assert player.sent == 0


def test_the_steady_clock_never_returns_early() -> None:
    clock = SteadyClock()
    for wait_ns in (-MS, 0, 50_000, MS, 20 * MS):
        moment_ns = time.monotonic_ns() + wait_ns
        clock.sleep_until(moment_ns)
        assert time.monotonic_ns() >= moment_ns


def message(at_ms: int, topic: str = "/a") -> Message:
    return Message(topic, "std_msgs/msg/String", b"%d" % at_ms, at_ms * MS, at_ms * MS, 0)


def test_the_timeline_begins_with_the_span_and_ends_with_it() -> None:
    recorded = [message(at) for at in (1, 2, 3, 4)]
    assert list(entries(list, lambda: recorded[1:3], Span(2 * MS, 3 * MS))) == [
        (0, "/a", b"2"),
        (1 * MS, "/a", b"3"),
    ]


def test_what_was_latched_before_comes_first_in_every_pass() -> None:
    held, recorded = [message(1, "/map"), message(3, "/map")], [message(9)]
    looping = entries(lambda: held, lambda: recorded, Span(4 * MS, 204 * MS), loop=True)
    one_pass = [(0, "/map", b"1"), (0, "/map", b"3"), (5 * MS, "/a", b"9")]
    assert [next(looping) for _ in range(6)] == one_pass + [
        (at_ns + 200 * MS, topic, data) for at_ns, topic, data in one_pass
    ]


def test_a_loop_goes_on_where_the_pass_before_ended() -> None:
    recorded = [message(at) for at in (0, 300)]
    looping = entries(list, lambda: recorded, Span(0, 300 * MS), loop=True)
    assert [next(looping)[0] for _ in range(4)] == [0, 300 * MS, 300 * MS, 600 * MS]
    single = entries(list, lambda: recorded[:1], Span(0, 0), loop=True)
    assert [next(single)[0] for _ in range(3)] == [0, MIN_PASS_NS, 2 * MIN_PASS_NS]


def test_reading_ahead_keeps_the_order_and_stops_at_its_limit() -> None:
    total = 3 * AHEAD_ENTRIES
    taken = 0

    def numbered() -> Iterator[Entry]:
        nonlocal taken
        for number in range(total):
            taken = number + 1
            yield number, "/a", b""

    with ReadAhead(numbered()) as ahead:
        seen = 0
        for batch in ahead:
            for number, _, _ in batch:
                assert number == seen
                seen += 1
            assert taken - seen <= AHEAD_ENTRIES + 2 * BATCH_ENTRIES
    assert seen == total


def test_what_reading_raises_comes_after_what_was_read() -> None:
    def broken() -> Iterator[Entry]:
        yield 0, "/a", b"1"
        raise OSError("the disk is gone")

    with ReadAhead(broken()) as ahead:
        batches = iter(ahead)
        assert next(batches) == [(0, "/a", b"1")]
        with pytest.raises(OSError, match="the disk is gone"):
            next(batches)


def test_what_is_due_and_not_sent_is_counted() -> None:
    timeline = [(number * MS, "/a", b"") for number in range(1000)]
    with ReadAhead(timeline, ahead=500) as ahead:
        batches = iter(ahead)
        first = next(batches)
        next(batches)
        begin = len(first) * MS
        assert ahead.count(begin, begin + 100 * MS) == 100
        assert ahead.count(begin + 100 * MS, begin) <= 0


def test_no_more_is_read_ahead_than_was_asked_for() -> None:
    taken = 0

    def numbered() -> Iterator[Entry]:
        nonlocal taken
        for number in range(100):
            taken = number + 1
            yield number, "/a", b""

    with ReadAhead(numbered(), ahead=5) as ahead:
        seen = 0
        for batch in ahead:
            seen += len(batch)
            assert taken - seen <= 5 + 5 + 1
    assert seen == 100


def test_reading_ahead_ends_while_it_waits_for_room() -> None:
    def endless() -> Iterator[Entry]:
        while True:
            yield 0, "/a", b""

    with ReadAhead(endless()) as ahead:
        next(iter(ahead))
    assert list(ahead) == []


def test_quantiles_are_at_most_a_thirtieth_too_high() -> None:
    dice = random.Random(5)
    values = sorted(round(dice.lognormvariate(9, 3)) for _ in range(5000))
    lateness = Lateness()
    for value in dice.sample(values, len(values)):
        lateness.add(value)
    for share in (0.01, 0.5, 0.99, 1.0):
        exact = values[max(round(share * len(values)) - 1, 0)]
        assert exact <= lateness.quantile_us(share) * 1e3 <= exact * 1.033 + 1
    assert lateness.max_ns == values[-1]


def test_early_and_huge_measurements_are_counted_at_the_ends() -> None:
    lateness = Lateness()
    assert lateness.quantile_us(0.5) == 0.0
    lateness.add(-5)
    assert lateness.quantile_us(1.0) == 0.0
    lateness.add(1 << 80)
    assert lateness.count == 2
    assert lateness.quantile_us(1.0) > 1e12
