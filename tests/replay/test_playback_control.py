"""A replay can be paused, stepped and made faster, and recorded time never jumps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from robotctl.replay.player import LEAD_NS, ClockPublisher, Player
from robotctl.replay.timeline import Entry

MS = 1_000_000
SECOND = 1_000_000_000

rates = st.sampled_from(RATES)
moments = st.integers(0, 10**15)


class ScriptClock:
    """A clock that only sleeping advances; each action of the script runs at its time."""

    def __init__(self, *script: tuple[int, Callable[[], object]]) -> None:
        self.time_ns = 0
        self.script = [(LEAD_NS + at_ns, action) for at_ns, action in script]

    def now_ns(self) -> int:
        return self.time_ns

    def sleep_until(self, moment_ns: int) -> None:
        while self.script and self.script[0][0] <= moment_ns:
            at_ns, action = self.script.pop(0)
            self.time_ns = max(self.time_ns, at_ns)
            action()
        self.time_ns = max(self.time_ns, moment_ns)


def play(
    clock: ScriptClock,
    timeline: list[Entry],
    *,
    rate: float | None = 1.0,
    paused: bool = False,
    delay_ns: int = 0,
    ticks: ClockPublisher | None = None,
) -> tuple[Player, list[tuple[int, int]]]:
    """Return a player, and when it sends each entry: ms after the start, number."""
    sent: list[tuple[int, int]] = []

    def send(data: bytes) -> bool:
        sent.append(((clock.time_ns - LEAD_NS) // MS, int(data)))
        return True

    player = Player(
        [timeline],
        {"/a": send},
        rate=rate,
        clock=clock,
        paused=paused,
        delay_ns=delay_ns,
        ticks=ticks,
    )
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
    for changed in (schedule.pause(now), schedule.resume(now), schedule.with_rate(now, other)):
        assert changed.position_ns(now) == schedule.position_ns(now)


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
    clock = ScriptClock()
    player, sent = play(clock, every_ms(6))
    clock.script = [
        (LEAD_NS + 250 * MS, player.control.toggle),
        (LEAD_NS + 2250 * MS, player.control.toggle),
    ]
    player.run()
    expected = [(n * 100 + 2000 * (n > 2), n) for n in range(6)]
    within(sent, expected, 51)


def test_another_rate_counts_from_where_the_replay_is() -> None:
    clock = ScriptClock()
    player, sent = play(clock, every_ms(6))
    clock.script = [(LEAD_NS + 250 * MS, player.control.faster)]
    player.run()
    expected = [
        (0, 0),
        (100, 1),
        (200, 2),
        *((250 + (n * 100 - 250) * 2 // 3, n) for n in (3, 4, 5)),
    ]
    within(sent, expected, 51)


def test_single_steps_send_one_message_each_and_stand_still_behind_it() -> None:
    clock = ScriptClock()
    player, sent = play(clock, every_ms(5), paused=True)
    control = player.control
    clock.script = [
        (LEAD_NS + SECOND, control.step),
        (LEAD_NS + 2 * SECOND, control.step),
        (LEAD_NS + 2 * SECOND, control.step),
        (LEAD_NS + 4 * SECOND, control.resume),
    ]
    player.run()
    within(sent, [(1000, 0), (2000, 1), (2000, 2), (4100, 3), (4200, 4)], 51)
    assert player.lateness.count == 2  # a step is asked for at no particular moment


def test_a_step_while_it_plays_changes_nothing() -> None:
    clock = ScriptClock()
    player, sent = play(clock, every_ms(3))
    clock.script = [(LEAD_NS + 50 * MS, player.control.step)]
    player.run()
    assert sent == [(0, 0), (100, 1), (200, 2)]
    assert not player.control.takes_step(0)


def test_a_delay_comes_before_the_first_message() -> None:
    player, sent = play(ScriptClock(), every_ms(2), delay_ns=3 * SECOND)
    player.run()
    assert sent == [(3000, 0), (3100, 1)]


def test_a_pause_stops_also_what_goes_as_fast_as_possible() -> None:
    clock = ScriptClock()
    player, sent = play(clock, every_ms(3), rate=None, paused=True)
    clock.script = [(LEAD_NS + 500 * MS, player.control.resume)]
    player.run()
    within(sent, [(500, n) for n in range(3)], 51)


def test_the_clock_ticks_in_real_time_and_tells_recorded_time() -> None:
    told: list[tuple[int, int]] = []
    clock = ScriptClock()
    ticks = ClockPublisher(20 * MS, lambda at_ns: told.append((clock.time_ns, at_ns)))
    player, _ = play(clock, every_ms(6), rate=2.0, ticks=ticks)
    clock.script = [
        (LEAD_NS + 100 * MS, player.control.pause),
        (LEAD_NS + 300 * MS, player.control.resume),
    ]
    player.run()
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


@pytest.mark.parametrize(
    "line", [b"", b"stop", b"[]", b'{"do": "explode"}', b'{"do": {}}', b"\xff"]
)
def test_what_is_no_command_is_none(line: bytes) -> None:
    assert command_of(line) is None


def test_keys_pressed_while_the_first_messages_are_read_make_none_late() -> None:
    clock, sent = ScriptClock(), list[int]()

    def batches() -> Iterator[list[Entry]]:
        clock.time_ns += SECOND
        player.control.faster()
        player.control.slower()
        player.control.toggle()
        player.control.toggle()
        yield [(number * 100 * MS, "/a", b"") for number in range(3)]

    def send(_: bytes) -> bool:
        sent.append((clock.time_ns - SECOND - LEAD_NS) // MS)
        return True

    player = Player(batches(), {"/a": send}, rate=1.0, clock=clock)
    player.run()
    assert sent == [0, 100, 200]
