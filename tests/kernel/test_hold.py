"""A velocity that a client holds to run: it ramps when let go, and silence is zero at once."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.kernel.course import MAX_SILENCE_S, Course, Held
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.tracking import limit
from robotctl.kernel.types import (
    ZERO,
    DriveEnded,
    DriveRequested,
    HoldReceived,
    LeaseRequested,
    ModeRequested,
    Phase,
    PublishTwist,
    Tick,
    Twist,
)
from robotctl.testing.kernels import Bench, ready
from tests.support.cases import for_each

MS = 1_000_000
FORWARD = Twist(0.3, 0.0)


def begun(bench: Bench, twist: Twist = FORWARD, silence_s: float = MAX_SILENCE_S) -> int:
    """Begin to hold a velocity to run; return the id of the hold."""
    bench.drive(laps=0, course=Course(held=Held(twist.linear, twist.angular, silence_s, 0)))
    return bench.replies[-1].request_id


def hold(bench: Bench, number: int, ticks: int, twist: Twist = FORWARD, client: int = 0) -> None:
    """Hold a velocity once before each tick."""
    for _ in range(ticks):
        bench.give(HoldReceived(bench.t_ns, number, twist, client))
        bench.run(1)


def held(ticks: int = 30, params: KernelParams | None = None) -> tuple[Bench, int]:
    """Return a bench that was held at FORWARD for some ticks, and the id of the hold."""
    bench = ready(params)
    number = begun(bench)
    hold(bench, number, ticks)
    return bench, number


def ended(bench: Bench) -> DriveEnded:
    (end,) = (effect for effect in bench.effects if isinstance(effect, DriveEnded))
    return end


def test_a_held_velocity_is_commanded_within_the_limits_as_long_as_it_is_held() -> None:
    bench, number = held(ticks=500)
    assert (bench.state.mode, bench.state.command) == (Mode.MOVING, FORWARD)
    hold(bench, number, 100, Twist(9.0, -9.0))
    limits = bench.kernel.params.limits
    assert bench.state.command == Twist(limits.linear_mps, -limits.angular_rps)
    for before, command in pairwise(bench.commands):
        assert limit(before, command, 0.02 + 1e-9, limits) == command


def test_silence_is_zero_at_once_and_before_the_longest_silence_is_over() -> None:
    bench, _ = held()
    bench.run(4)  # 100 ms after the last word
    assert bench.state.command == FORWARD
    bench.run(1)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO)
    assert ended(bench).reason == "not held for 125 ms"
    assert not ended(bench).completed


def test_what_comes_after_the_silence_moves_nothing() -> None:
    bench, number = held()
    bench.run(10)
    hold(bench, number, 20)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO)


def test_one_who_lets_go_sees_the_ramp_begin_in_the_same_step_and_end_in_idle() -> None:
    bench, number = held()
    bench.t_ns += 10 * MS
    (ramp,) = bench.give(HoldReceived(bench.t_ns, number, ZERO))
    assert isinstance(ramp, PublishTwist)
    assert ramp.twist.linear == pytest.approx(0.3 - 1.0 * 0.01)
    assert bench.give(HoldReceived(bench.t_ns, number, ZERO)) == (), "once for each release"
    bench.t_ns += 10 * MS
    (next_command,) = bench.give(Tick(bench.t_ns))
    assert isinstance(next_command, PublishTwist)
    assert next_command.twist.linear == pytest.approx(0.3 - 1.0 * 0.02)
    hold(bench, number, 40, ZERO)
    assert (bench.state.mode, bench.state.reason) == (Mode.IDLE, "let go")
    assert ended(bench).completed
    assert ended(bench).report.laps == 1
    limits = bench.kernel.params.limits
    for before, command in pairwise(bench.commands):
        assert limit(before, command, 0.02 + 1e-9, limits) == command


def test_one_who_holds_again_during_the_ramp_goes_on() -> None:
    bench, number = held()
    hold(bench, number, 5, ZERO)
    assert 0.0 < bench.state.command.linear < 0.3
    hold(bench, number, 20)
    assert (bench.state.mode, bench.state.command) == (Mode.MOVING, FORWARD)


def test_silence_cuts_a_ramp() -> None:
    bench, number = held()
    bench.request(Mode.IDLE)
    hold(bench, number, 3)
    assert bench.state.phase is Phase.STOPPING
    assert 0.0 < bench.state.command.linear < 0.3
    bench.run(6)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO)
    assert bench.state.reason == "requested by test"


@for_each("other", [6, 8])
def test_nobody_steers_a_hold_but_the_client_that_has_the_lease(other: int) -> None:
    bench = ready()
    bench.give(LeaseRequested(bench.t_ns, bench.new_request_id(), True, 7, "holder"))
    number = bench.new_request_id()
    course = Course(held=Held(0.3, 0.0, MAX_SILENCE_S, 0))
    bench.give(
        DriveRequested(
            bench.t_ns, number, bench.kernel.params.pattern, 1, False, "holder", 7, course=course
        )
    )
    hold(bench, number, 20, client=7)
    assert bench.state.command == FORWARD
    hold(bench, number, 10, Twist(0.5, 0.0), client=other)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO), "it is silence"


@for_each("other", [-1, 1])
def test_another_number_does_not_hold_this_motion(other: int) -> None:
    bench, number = held()
    hold(bench, number + other, 10)
    assert bench.state.mode is Mode.IDLE


def test_a_motion_that_is_not_held_to_run_takes_no_other_velocity() -> None:
    bench = ready()
    bench.drive(course=Course(held=Held(0.1, 0.0, 1.0)))
    drive = bench.state.drive
    assert drive is not None
    bench.give(HoldReceived(bench.t_ns, drive.request_id, FORWARD))
    bench.run(20)
    assert bench.state.command == Twist(0.1, 0.0)
    bench.drive(replacing=True)
    before = bench.state
    assert before.drive is not None
    assert bench.give(HoldReceived(bench.t_ns, before.drive.request_id, FORWARD)) == ()
    assert bench.state == before


@for_each("twist", [Twist(nan, 0.0), Twist(0.1, inf), Twist(-inf, nan)])
def test_a_velocity_that_is_no_number_is_silence(twist: Twist) -> None:
    bench, number = held()
    hold(bench, number, 6, twist)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO)


def test_a_longer_silence_than_the_longest_is_refused() -> None:
    bench = ready()
    begun(bench, silence_s=0.126)
    assert bench.replies[-1].message == "a silence of 0.126 s: use at most 0.125 s"
    assert bench.state.mode is Mode.IDLE


def test_a_time_that_the_client_claims_counts_for_nothing() -> None:
    bench = ready()
    far = bench.t_ns + 3600 * 1000 * MS
    bench.drive(course=Course(held=Held(0.3, 0.0, MAX_SILENCE_S, far)))
    bench.run(7)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO)


def test_a_hold_of_zero_ends_with_its_first_tick() -> None:
    bench = ready()
    begun(bench, ZERO)
    bench.run(1)
    assert (bench.state.mode, bench.state.reason) == (Mode.IDLE, "let go")


def test_another_motion_is_not_interrupted_by_a_hold() -> None:
    bench = ready()
    bench.drive()
    begun(bench)
    assert not bench.replies[-1].ok


@for_each(("rate_hz", "zero_after_ms"), [(10.0, 100), (20.0, 100), (100.0, 120)])
def test_at_every_rate_silence_is_zero_within_its_time(rate_hz: float, zero_after_ms: int) -> None:
    period_ms = round(1000 / rate_hz)
    bench = ready(replace(KernelParams(), rate_hz=rate_hz))
    number = begun(bench)
    for _ in range(30):
        bench.t_ns += period_ms * MS
        bench.odometry()
        bench.give(HoldReceived(bench.t_ns, number, FORWARD))
        bench.give(Tick(bench.t_ns))
    assert bench.state.command == FORWARD
    last_ns = bench.t_ns
    while bench.state.command != ZERO:
        bench.t_ns += period_ms * MS
        bench.odometry()
        bench.give(Tick(bench.t_ns))
    assert (bench.t_ns - last_ns) // MS == zero_after_ms


@given(
    st.lists(
        st.tuples(
            st.integers(0, 60),
            st.one_of(st.none(), st.builds(Twist, st.floats(-2.0, 2.0), st.floats(-4.0, 4.0))),
        ),
        max_size=60,
    ),
    st.integers(0, 19),
)
def test_whatever_is_held_and_whenever_no_command_outlives_the_silence(
    wishes: list[tuple[int, Twist | None]], offset_ms: int
) -> None:
    """A wish of None ends the request for it: somebody asks for IDLE."""
    limits = VelocityLimits()
    bench = ready()
    number = begun(bench)
    heard_ns, commanded, next_tick_ns = bench.t_ns, ZERO, bench.t_ns + 20 * MS
    due: list[tuple[int, Twist | None]] = []
    at_ns = bench.t_ns + offset_ms * MS
    for wait_ms, twist in wishes:
        at_ns += wait_ms * MS
        due.append((at_ns, twist))
    while bench.state.mode is Mode.MOVING:
        if due and due[0][0] < next_tick_ns:
            bench.t_ns, twist = due.pop(0)
            if twist is None:
                effects = bench.give(
                    ModeRequested(bench.t_ns, bench.new_request_id(), Mode.IDLE.value, "test")
                )
            else:
                heard_ns = bench.t_ns
                effects = bench.give(HoldReceived(bench.t_ns, number, twist))
        else:
            bench.t_ns, next_tick_ns = next_tick_ns, next_tick_ns + 20 * MS
            bench.odometry()
            effects = bench.give(Tick(bench.t_ns))
        for effect in effects:
            if isinstance(effect, PublishTwist):
                if effect.twist != ZERO:
                    assert limit(commanded, effect.twist, 0.02 + 1e-9, limits) == effect.twist
                    assert bench.t_ns - heard_ns < 125 * MS
                commanded = effect.twist
    assert commanded == ZERO
    assert bench.t_ns - heard_ns <= 125 * MS or not due


def test_the_limits_of_a_held_velocity_are_allowed_themselves() -> None:
    for seconds in (0.02, 600.0):
        assert Held(0.1, 0.0, seconds).refusal() == ""
    for seconds in (0.019, 600.1):
        assert "a velocity for" in Held(0.1, 0.0, seconds).refusal()
    for silence_s in (0.1, 0.125):
        assert Held(0.1, 0.0, silence_s, 0).refusal() == ""
    assert Held(0.1, 0.0, 0.126).refusal() == "", "it is not held to run"


@for_each("period_s", [0.0625, 0.1, 1.0])
def test_a_silence_is_too_long_if_it_would_be_at_the_next_tick_or_half_of_it_is_over(
    period_s: float,
) -> None:
    held = Held(0.1, 0.0, 0.125, 1000 * MS)
    assert not held.is_silent(1000 * MS + 62_500_000, period_s)
    assert held.is_silent(1000 * MS + 62_500_001, period_s)
    assert not held.is_silent(1000 * MS - 62_500_000, period_s), "a clock that goes back"
    assert held.is_silent(1000 * MS - 62_500_001, period_s)
    assert not Held(0.1, 0.0, 0.125).is_silent(0, period_s)


def test_a_velocity_is_let_go_if_both_its_parts_are_zero() -> None:
    assert Held(0.0, 0.0, 0.125, 0).is_let_go
    assert not Held(0.0, 0.1, 0.125, 0).is_let_go
    assert not Held(0.1, 0.0, 0.125, 0).is_let_go
    assert not Held(0.0, 0.0, 0.125).is_let_go


def test_a_request_to_stop_during_the_ramp_is_the_reason_of_the_end() -> None:
    bench, number = held()
    hold(bench, number, 3, ZERO)
    bench.request(Mode.IDLE)
    hold(bench, number, 40, ZERO)
    assert (bench.state.mode, bench.state.reason) == (Mode.IDLE, "requested by test")
    assert not ended(bench).completed
