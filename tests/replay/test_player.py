"""The player keeps an absolute schedule, and reads ahead within limits.

A replay at full speed waits for subscribers, and for none of them for ever.
A replay can be paused, stepped and made faster, and recorded time never jumps.
A recorded robot is shown as it was at that moment.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.geometry import Pose
from robotctl.recording import Message, Recording
from robotctl.replay.job import MAX_RATE, MIN_RATE
from robotctl.replay.playback_control import (
    RATES,
    Command,
    PlaybackControl,
    Schedule,
    carry_out,
    command_of,
    faster,
    slower,
)
from robotctl.replay.player import LEAD_NS, ClockPublisher, Lateness, Player, SteadyClock
from robotctl.replay.recorded_robot import RecordedRobot
from robotctl.replay.timeline import (
    AHEAD_ENTRIES,
    BATCH_ENTRIES,
    MIN_PASS_NS,
    Entry,
    ReadAhead,
    Span,
    entries,
)
from robotctl.ros import playback
from robotctl.ros.playback import PatientSender
from tests.support.bags import ODOMETRY, START_NS, STATUS, Line, odometry, status, write_bag

MS = 1_000_000


class ScriptClock:
    """A clock that only sleeping advances; each action of the script runs at its time."""

    def __init__(self) -> None:
        self.time_ns = 0
        self.script: list[tuple[int, Callable[[], object]]] = []

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until(self, moment_ns: int) -> None:
        while self.script and self.script[0][0] <= moment_ns:
            at_ns, action = self.script.pop(0)
            self.time_ns = max(self.time_ns, at_ns)
            action()
        self.time_ns = max(self.time_ns, moment_ns)


def play(
    timeline: list[Entry], *, rate: float | None = 1.0, cost_ns: int = 0, sends: bool = True
) -> tuple[list[tuple[int, bytes]], Player]:
    """Return what was sent, and when, relative to the start of the schedule."""
    clock = ScriptClock()
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


@pytest.mark.parametrize(("ahead_entries", "size"), [(AHEAD_ENTRIES, BATCH_ENTRIES), (5, 5)])
def test_reading_ahead_keeps_the_order_and_stops_at_its_limit(
    ahead_entries: int, size: int
) -> None:
    total = 3 * AHEAD_ENTRIES
    taken = 0

    def numbered() -> Iterator[Entry]:
        nonlocal taken
        for number in range(total):
            taken = number + 1
            yield number, "/a", b""

    with ReadAhead(numbered(), ahead=ahead_entries) as ahead:
        seen = 0
        for batch in ahead:
            for number, _, _ in batch:
                assert number == seen
                seen += 1
            assert taken - seen <= ahead_entries + 2 * size
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


class Publisher:
    """Keeps what was published; `looks` looks for acknowledgements fail before one succeeds."""

    topic_name = "/alpha"
    qos_profile = SimpleNamespace(depth=4)

    def __init__(self, looks: int = 0) -> None:
        self.published: list[bytes] = []
        self.waits: list[int] = []
        self._looks = looks
        self._left = looks

    def publish(self, data: bytes) -> None:
        self.published.append(data)

    def wait_for_all_acked(self, _: object) -> bool:
        if self._left:
            self._left -= 1
            return False
        self._left = self._looks
        self.waits.append(len(self.published))
        return True


def sender_of(publisher: Any, in_flight: int = 3) -> PatientSender:
    return PatientSender(publisher, in_flight, threading.Event())


def test_it_waits_before_more_messages_are_on_their_way() -> None:
    publisher = Publisher(looks=2)
    send = sender_of(publisher)
    assert all(send(b"%d" % number) for number in range(10))
    assert publisher.published == [b"%d" % number for number in range(10)]
    assert (publisher.waits, send.given_up) == ([3, 6, 9], 0)


def test_it_waits_before_the_publisher_forgets_a_message() -> None:
    publisher = Publisher()
    send = sender_of(publisher, in_flight=100)
    for _ in range(9):
        send(b"")
    assert publisher.waits == [4, 8]


def test_it_gives_up_after_a_while_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(playback, "BLOCKED_S", 0.01)
    publisher = Publisher(looks=10**9)
    send = sender_of(publisher)
    assert all(send(b"") for _ in range(8))
    assert (len(publisher.published), send.given_up) == (8, 2)


def test_a_stop_ends_its_wait() -> None:
    publisher: Any = Publisher(looks=10**9)
    stopped = threading.Event()
    send = PatientSender(publisher, 1, stopped)
    send(b"")
    stopped.set()
    begun = time.monotonic()
    send(b"")
    assert time.monotonic() - begun < playback.BLOCKED_S


rates = st.sampled_from(RATES)
moments = st.integers(0, 10**15)


def play_script(
    timeline: list[Entry],
    *script: tuple[int, str],
    clock: ScriptClock | None = None,
    **options: Any,
) -> tuple[Player, list[tuple[int, int]]]:
    """Return a player, and when it sent each entry: ms after the start, number.

    The script names calls of its control, each with its time [ms].
    """
    clock, sent = clock or ScriptClock(), list[tuple[int, int]]()

    def send(data: bytes) -> bool:
        sent.append(((clock.time_ns - LEAD_NS) // MS, int(data)))
        return True

    player = Player([timeline], {"/a": send}, clock=clock, **{"rate": 1.0, **options})
    clock.script = [(LEAD_NS + ms * MS, getattr(player.control, name)) for ms, name in script]
    player.run()
    return player, sent


def every_ms(count: int, period: int = 100) -> list[Entry]:
    return [(number * period * MS, "/a", b"%d" % number) for number in range(count)]


def within(found: list[tuple[int, int]], expected: list[tuple[int, int]], late_ms: int) -> None:
    """Check that these are the same messages, none early, and none later than SLICE_NS allows."""
    assert [number for _, number in found] == [number for _, number in expected]
    for (at, _), (due, _) in zip(found, expected, strict=True):
        assert due <= at <= due + late_ms


@given(moments, moments, rates, st.booleans(), st.integers(0, 10**12), rates)
def test_no_change_makes_recorded_time_jump(
    moment: int, at: int, rate: float, paused: bool, later: int, other: float
) -> None:
    schedule = Schedule(moment, at, rate, paused)
    now = moment + later
    for change in ({"paused": True}, {"paused": False}, {"rate": other}):
        assert schedule.changed(now, **change).position_ns(now) == schedule.position_ns(now)


@given(moments, moments, rates, st.integers(0, 10**12))
def test_what_is_due_is_what_the_position_has_reached(
    moment: int, at: int, rate: float, ahead: int
) -> None:
    schedule = Schedule(moment, at, rate)
    due_ns = schedule.due_ns(at + ahead)
    assert abs(schedule.position_ns(due_ns) - (at + ahead)) <= 1 + rate


def test_keys_walk_through_round_rates_and_stay_within_the_limits() -> None:
    assert [faster(1.0), faster(1.5), faster(4.0), slower(1.0), slower(1.7)] == [
        1.5, 2.0, 5.0, 0.7, 1.5,
    ]  # fmt: skip
    assert (faster(MAX_RATE), slower(MIN_RATE)) == (MAX_RATE, MIN_RATE)
    assert (RATES[0], RATES[-1]) == (MIN_RATE, MAX_RATE)


def test_a_pause_moves_what_follows_by_its_length() -> None:
    _, sent = play_script(every_ms(6), (250, "toggle"), (2250, "toggle"))
    expected = [(n * 100 + 2000 * (n > 2), n) for n in range(6)]
    within(sent, expected, 51)


def test_another_rate_counts_from_where_the_replay_is() -> None:
    _, sent = play_script(every_ms(6), (250, "faster"))
    faster = [(250 + (n * 100 - 250) * 2 // 3, n) for n in (3, 4, 5)]
    within(sent, [(0, 0), (100, 1), (200, 2), *faster], 51)


def test_single_steps_send_one_message_each_and_stand_still_behind_it() -> None:
    script = (1000, "step"), (2000, "step"), (2000, "step"), (4000, "resume")
    player, sent = play_script(every_ms(5), *script, paused=True)
    within(sent, [(1000, 0), (2000, 1), (2000, 2), (4100, 3), (4200, 4)], 51)
    assert player.lateness.count == 2  # a step is asked for at no particular moment


def test_a_pause_stops_also_what_goes_as_fast_as_possible() -> None:
    _, sent = play_script(every_ms(3), (500, "resume"), rate=None, paused=True)
    within(sent, [(500, n) for n in range(3)], 51)


def test_the_clock_ticks_in_real_time_and_tells_recorded_time() -> None:
    told: list[tuple[int, int]] = []
    clock = ScriptClock()
    ticks = ClockPublisher(20 * MS, lambda at_ns: told.append((clock.time_ns, at_ns)))
    play_script(every_ms(6), (100, "pause"), (300, "resume"), clock=clock, rate=2.0, ticks=ticks)
    times = [real for real, _ in told]
    assert {b - a for a, b in pairwise(times)} == {20 * MS}
    running = [(at, recorded) for at, recorded in told if LEAD_NS <= at <= LEAD_NS + 100 * MS]
    assert [recorded for _, recorded in running] == [(at - LEAD_NS) * 2 for at, _ in running]
    resting = [recorded for at, recorded in told if 120 <= (at - LEAD_NS) // MS <= 300]
    assert len(resting) >= 9
    assert set(resting) == {200 * MS}


def test_ticks_that_were_missed_are_not_made_up_for() -> None:
    told: list[int] = []
    ticks = ClockPublisher(10, told.append)
    for now in (0, 5, 10, 1000, 1005, 1010):
        ticks.tick(now, now)
    assert told == [0, 10, 1000, 1010]


@pytest.mark.parametrize("command", Command)
def test_every_command_crosses_to_the_player_and_does_something_harmless(command: Command) -> None:
    control = PlaybackControl(1.0, lambda: 0)
    assert command_of(command.line().rstrip(b"\n")) is command
    carry_out(command, control)
    assert control.schedule.position_ns(0) == 0


@contextmanager
def seen(tmp_path: Path, lines: list[Line], **options: Any) -> Iterator[RecordedRobot]:
    with Recording(write_bag(tmp_path / "run.mcap", lines)) as recording:
        info = recording.info()
        span = Span(info.start_ns + options.get("skip_ms", 0) * 10**6, info.end_ns)
        yield RecordedRobot(recording, span, loop=options.get("loop", False))


@pytest.mark.parametrize("endian", ["<", ">"])
def test_pose_velocity_and_path_are_those_of_the_moment(tmp_path: Path, endian: str) -> None:
    with seen(tmp_path, [odometry(n * 100.0, n * 1.0, endian=endian) for n in range(10)]) as robot:
        robot.advance(350 * 10**6)
        assert robot.pose == Pose(3.0, 6.0, 0.0)
        assert robot.velocity is not None
        assert (robot.velocity.linear, robot.velocity.angular) == (0.25, 0.0)
        assert robot.path == [(float(n), 2.0 * n) for n in range(4)]
        assert robot.mode is None
        assert robot.next_ns == 400 * 10**6


def test_after_an_offset_the_mode_is_known_from_before_and_the_path_begins_there(
    tmp_path: Path,
) -> None:
    lines = [status(0, 3), *(odometry(n * 100.0, n * 1.0) for n in range(10))]
    with seen(tmp_path, lines, skip_ms=500) as robot:
        robot.advance(0)
        assert robot.mode == "EMERGENCY_STOP"
        robot.advance(10**10)
        assert robot.path == [(float(n), 2.0 * n) for n in range(4, 10)]
        assert robot.next_ns is None


def test_a_loop_begins_a_new_path(tmp_path: Path) -> None:
    with seen(tmp_path, [odometry(n * 100.0, n * 1.0) for n in range(5)], loop=True) as robot:
        robot.advance(399 * 10**6)
        assert len(robot.path) == 4
        robot.advance(550 * 10**6)
        assert robot.path == [(1.0, 2.0)]


@given(st.binary(max_size=900))
def test_no_message_can_break_the_view(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        topics = (("/odom", ODOMETRY), ("/robot_status", STATUS))
        lines = [Line(topic, kind, 0.0, content) for topic, kind in topics]
        with seen(Path(folder), lines) as robot:
            robot.advance(START_NS)


def test_what_is_due_and_not_sent_is_counted() -> None:
    timeline = [(number * MS, "/a", b"") for number in range(1000)]
    with ReadAhead(timeline, ahead=500) as ahead:
        batches = iter(ahead)
        first = next(batches)
        next(batches)
        begin = len(first) * MS
        assert ahead.count(begin, begin + 100 * MS) == 100
        assert ahead.count(begin + 100 * MS, begin) <= 0
