"""A held velocity may be followed by silence, in which the base must stop by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import nan

import pytest

from robotctl.kernel.course import MAX_QUIET_S, Course, Held
from robotctl.kernel.drive import Drive, Progress
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import VelocityLimits
from robotctl.kernel.patterns import Pattern, named
from robotctl.kernel.types import ZERO, PublishTwist, Twist
from robotctl.testing.kernels import Bench, drive_simulated, ready

SPEED = Twist(0.1, 0.0)
HELD = Held(SPEED.linear, 0.0, 1.0, quiet_s=0.5)


def in_quiet(held: Held = HELD) -> Bench:
    """Return a bench whose last tick sent nothing."""
    bench = ready()
    assert bench.drive(course=Course(held=held))
    while bench.tick():
        bench.odometry()
    return bench


def test_after_its_time_a_velocity_is_followed_by_silence_and_then_by_one_zero() -> None:
    bench = ready()
    begin_ns = bench.t_ns
    bench.drive(course=Course(held=HELD))
    sent: list[tuple[float, Twist]] = []
    while bench.state.mode is Mode.MOVING:
        bench.odometry()
        sent += [
            ((bench.t_ns - begin_ns) / 1e9, effect.twist)
            for effect in bench.tick()
            if isinstance(effect, PublishTwist)
        ]
    (last_s, last), (end_s, end) = sent[-2:]
    assert (last, end) == (SPEED, ZERO)
    assert last_s == pytest.approx(1.0, abs=0.05)
    assert end_s == pytest.approx(1.5, abs=0.05)
    assert bench.state.reason == "drive finished: 1.5 s"


def test_a_velocity_without_silence_is_commanded_at_every_tick() -> None:
    bench = ready()
    bench.drive(course=Course(held=Held(0.1, 0.0, 0.5)))
    while bench.state.mode is Mode.MOVING:
        bench.odometry()
        assert any(isinstance(effect, PublishTwist) for effect in bench.tick())


def is_asked_to_stand(bench: Bench) -> None:
    bench.request(Mode.IDLE.value)


def is_stopped(bench: Bench) -> None:
    bench.request(Mode.EMERGENCY_STOP.value)


def loses_odometry(bench: Bench) -> None:
    for _ in range(40):
        bench.tick()
        if bench.state.mode is not Mode.MOVING:
            return


@pytest.mark.parametrize("ends", [is_asked_to_stand, is_stopped, loses_odometry])
def test_what_ends_the_silence_sends_zero_at_once_and_no_ramp(
    ends: Callable[[Bench], None],
) -> None:
    bench = in_quiet(Held(0.5, 0.0, 1.0, quiet_s=5.0))
    before = len(bench.commands)
    ends(bench)
    bench.odometry()
    bench.tick()
    assert bench.state.mode is not Mode.MOVING
    assert set(bench.commands[before:]) == {ZERO}


def test_the_silence_begins_when_the_time_is_over() -> None:
    drive = Drive(1, Pattern(), 1, ORIGIN, Progress(length=1.0), course=Course(held=HELD))
    assert drive.is_quiet
    assert not replace(drive, progress=Progress(length=0.99)).is_quiet


@pytest.mark.parametrize(("held_s", "is_over"), [(1.25, True), (1.24, False)])
def test_a_drive_ends_when_the_silence_is_over(held_s: float, is_over: bool) -> None:
    drive = Drive(1, Pattern(), 1, ORIGIN, Progress(length=held_s), course=Course(held=HELD))
    assert drive.advance(0.25, ORIGIN, VelocityLimits(), 4).finished is is_over


def test_in_silence_the_command_counts_as_going_on_so_that_obstacles_still_stop() -> None:
    assert in_quiet().state.command == SPEED


def test_a_drive_that_replaces_the_silence_begins_at_zero() -> None:
    bench = in_quiet(Held(0.5, 0.0, 1.0, quiet_s=5.0))
    bench.drive(replacing=True, course=Course(held=Held(0.5, 0.0, 1.0)))
    bench.tick()
    assert 0.0 < bench.state.command.linear < 0.05


@pytest.mark.parametrize("quiet_s", [-0.1, MAX_QUIET_S + 0.1, nan])
def test_a_silence_that_is_not_allowed_is_refused_by_its_limits(quiet_s: float) -> None:
    assert Held(0.1, 0.0, 1.0, quiet_s=quiet_s).refusal().endswith("use 0 to 5 s")
    assert Held(0.1, 0.0, 1.0, quiet_s=MAX_QUIET_S).refusal() == ""


def test_the_silence_is_named() -> None:
    assert named(Pattern(), Course(held=HELD)) == (
        "0.1 m/s and 0 rad/s for 1 s, then nothing for 0.5 s"
    )


def test_the_simulated_base_stops_by_its_own_timeout() -> None:
    result = drive_simulated(
        Pattern(), laps=1, course=Course(held=Held(0.1, 0.0, 1.0, quiet_s=2.0))
    )
    assert result.ended.report.distance_m == pytest.approx(0.15, abs=0.02)
