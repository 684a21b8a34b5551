"""Each request gets one reply, after the effects that it confirms; a stop wins over a start.

Hand-over: others may drive in IDLE, and robotctl takes over without two that command.
A held velocity may be followed by silence, in which the base must stop by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import nan

import pytest

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import MAX_QUIET_S, Course, Held
from robotctl.kernel.drive import Drive, Progress
from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import CommandParams, Foreign, KernelParams, VelocityLimits, WhenIdle
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.state import latched
from robotctl.kernel.types import (
    RESETTING,
    ZERO,
    Cause,
    CommandPublishersSeen,
    DriveEnded,
    Effect,
    FaultReported,
    ForeignCommandHeard,
    LatchEmergencyStop,
    ModeChanged,
    ModeRequested,
    Phase,
    PublishTwist,
    ReleaseEmergencyStop,
    Remedy,
    Reply,
    ResetRequested,
    Twist,
)
from robotctl.testing.kernels import (
    Bench,
    drive_simulated,
    in_mode,
    moving,
    ready,
    start,
    stopped_by,
    stopping,
    while_moving,
)
from tests.support.cases import for_each

CIRCLE = Pattern(PatternKind.CIRCLE, 0.5, 0.3)


def kinds(effects: tuple[Effect, ...]) -> list[type[Effect]]:
    return [type(effect) for effect in effects]


def reset(bench: Bench) -> tuple[Effect, ...]:
    return bench.give(ResetRequested(bench.t_ns, bench.new_request_id(), "test"))


@for_each("mode", [Mode.IDLE, Mode.MOVING, Mode.ERROR])
def test_an_emergency_stop_is_zero_first_then_latched_then_answered(mode: Mode) -> None:
    bench = in_mode(mode)
    effects = bench.request(Mode.EMERGENCY_STOP)
    assert effects[0] == PublishTwist(ZERO)
    assert kinds(effects)[:3] == [PublishTwist, LatchEmergencyStop, ModeChanged]
    assert kinds(effects)[-1] is Reply
    assert bench.state.command == ZERO


def test_an_emergency_stop_cuts_a_ramp_and_refuses_who_waits_for_it() -> None:
    bench = stopping()
    waiting = bench.state.waiting
    bench.request(Mode.EMERGENCY_STOP)
    refused = [reply for reply in bench.replies if reply.request_id in waiting]
    assert [reply.ok for reply in refused] == [False]
    assert "EMERGENCY_STOP" in refused[0].message
    assert bench.replies[-1].ok


def test_a_second_emergency_stop_says_zero_again_and_is_answered() -> None:
    bench = in_mode(Mode.EMERGENCY_STOP)
    effects = bench.request(Mode.EMERGENCY_STOP)
    assert kinds(effects) == [PublishTwist, Reply]
    assert bench.replies[-1].message == "Mode is already EMERGENCY_STOP"


def test_a_reset_releases_the_latch_alone_and_says_so_then() -> None:
    released = [PublishTwist, ReleaseEmergencyStop, ModeChanged, Reply]
    for mode, effects, said in (
        (Mode.IDLE, [PublishTwist, Reply], "Nothing to reset: mode is IDLE"),
        (Mode.ERROR, [PublishTwist, ModeChanged, Reply], "ERROR cleared: mode changed to IDLE"),
        (Mode.EMERGENCY_STOP, released, "EMERGENCY_STOP released: mode changed to IDLE"),
    ):
        bench = in_mode(mode)
        assert kinds(reset(bench)) == effects
        assert bench.replies[-1].message == said


def test_a_latched_stop_outlives_the_process() -> None:
    bench = Bench(state=latched("stopped before the restart"))
    bench.run(5)
    stopped = bench.state
    assert stopped.mode is Mode.EMERGENCY_STOP
    bench.request(Mode.MOVING)
    assert not bench.replies[-1].ok
    assert bench.replies[-1].remedies == (Remedy.RELEASE_STOP,)
    reset(bench)
    assert bench.state.mode is Mode.IDLE


def test_a_request_for_idle_is_answered_when_the_command_is_exactly_zero() -> None:
    bench = moving(ticks=15)
    asked_at = len(bench.replies)
    bench.request(Mode.IDLE)
    bench.request(Mode.IDLE)
    assert bench.state.mode is Mode.MOVING
    assert bench.state.phase is Phase.STOPPING
    ramp = 0
    for _ in while_moving(bench):
        assert len(bench.replies) == asked_at
        effects = bench.tick()
        ramp += 1
    assert ramp > 1
    assert kinds(effects) == [PublishTwist, ModeChanged, DriveEnded, Reply, Reply]
    assert effects[0] == PublishTwist(ZERO)
    assert [reply.ok for reply in bench.replies[asked_at:]] == [True, True]


def test_a_robot_that_is_stopping_cannot_be_moved() -> None:
    bench = stopping()
    before = bench.state
    bench.request(Mode.MOVING)
    bench.drive(CIRCLE, replacing=True)
    assert [reply.ok for reply in bench.replies[-2:]] == [False, False]
    assert "stopping" in bench.replies[-1].message
    assert bench.state == before


def test_the_first_who_asks_names_the_stop() -> None:
    bench = moving(ticks=15)
    for source in ("the first", "the second"):
        bench.give(ModeRequested(bench.t_ns, bench.new_request_id(), 0, source))
    bench.run(200)
    assert bench.state.mode is Mode.IDLE
    assert bench.state.reason == "requested by the first"


@for_each("stopped_in", [Mode.ERROR, Mode.EMERGENCY_STOP])
def test_a_drive_whose_last_ramp_is_cut_is_not_completed(stopped_in: Mode) -> None:
    bench = stopping()
    assert bench.state.drive is not None
    finished = replace(bench.state.drive, laps=1, progress=Progress(laps=1))
    assert finished.finished
    bench.kernel.state = replace(bench.state, drive=finished)
    (ended,) = (each for each in bench.request(stopped_in) if isinstance(each, DriveEnded))
    assert not ended.completed


def test_a_drive_is_replaced_only_on_request() -> None:
    bench = moving()
    before = bench.state
    bench.drive(CIRCLE)
    assert not bench.replies[-1].ok
    assert bench.replies[-1].remedies == (Remedy.STOP_OR_REPLACE,)
    assert bench.state == before
    effects = bench.drive(CIRCLE, replacing=True)
    assert kinds(effects) == [DriveEnded, Reply]
    (ended,) = (each for each in effects if isinstance(each, DriveEnded))
    assert (ended.completed, ended.reason) == (False, "replaced by another drive")
    *_, allowed = bench.replies
    assert allowed.ok
    assert bench.state.drive is not None
    assert bench.state.drive.pattern == CIRCLE


def test_a_drive_that_cannot_begin_does_not_end_the_one_it_would_replace() -> None:
    bench = moving()
    before = bench.state
    bench.t_ns += 600_000_000  # odometry is lost, but no tick has found out yet
    effects = bench.drive(CIRCLE, replacing=True)
    assert kinds(effects) == [Reply]
    assert not bench.replies[-1].ok
    assert replace(bench.state, health=before.health) == before


@for_each("mode", [Mode.ERROR, Mode.EMERGENCY_STOP])
def test_no_drive_leads_out_of_a_stop(mode: Mode) -> None:
    bench = in_mode(mode)
    bench.drive(CIRCLE, replacing=True)
    assert not bench.replies[-1].ok
    assert not RESETTING.isdisjoint(bench.replies[-1].remedies)
    assert bench.state.mode is mode


@for_each("number", [-1, len(Mode), 255, 2**63])
def test_an_unknown_mode_is_refused_with_the_valid_ones(number: int) -> None:
    bench = moving()
    before = bench.state
    bench.request(number)
    assert "use 0 IDLE, 1 MOVING, 2 ERROR, 3 EMERGENCY_STOP" in bench.replies[-1].message
    assert bench.state == before


def test_a_reset_is_refused_while_the_cause_or_another_one_would_stop_again() -> None:
    from robotctl.kernel.types import FaultCleared, FaultReported

    bench = in_mode(Mode.EMERGENCY_STOP)
    bench.give(FaultReported(bench.t_ns, Cause.RECORDER_FAILED, "the disk is full"))
    reset(bench)
    assert not bench.replies[-1].ok
    assert "the disk is full" in bench.replies[-1].message
    stopped = bench.state
    assert stopped.mode is Mode.EMERGENCY_STOP
    bench.give(FaultCleared(bench.t_ns, Cause.RECORDER_FAILED))
    reset(bench)
    assert bench.state.mode is Mode.IDLE


@for_each(("ticks", "duration_s"), [(0, 0.0), (25, 0.5)])
def test_the_report_of_a_drive_tells_the_time_from_its_request_to_its_last_tick(
    ticks: int, duration_s: float
) -> None:
    bench = Bench()
    bench.odometry()
    bench.battery(1.0)
    bench.drive()
    bench.run(ticks)
    bench.t_ns += 7_000_000
    bench.request(Mode.ERROR)
    (ended,) = (effect for effect in bench.effects if isinstance(effect, DriveEnded))
    assert ended.report.duration_s == duration_s


QUIET = replace(KernelParams(), command=CommandParams(when_idle=WhenIdle.SILENT))


def yielding() -> Bench:
    command = CommandParams(when_idle=WhenIdle.SILENT, foreign=Foreign.YIELD)
    bench = ready(replace(KernelParams(), command=command))
    bench.run(60)
    return bench


def sent(bench: Bench) -> bool:
    return PublishTwist(ZERO) in bench.tick()


def test_in_idle_zeros_are_sent_for_a_second_and_nothing_then() -> None:
    bench = Bench(QUIET)
    assert sent(bench)
    begin_ns = bench.t_ns
    while sent(bench):
        assert not bench.state.silent
    assert bench.t_ns - begin_ns == NS_PER_S
    assert bench.state.silent
    bench.run(100)
    assert not sent(bench)


@for_each("mode", [Mode.ERROR, Mode.EMERGENCY_STOP])
def test_error_and_emergency_stop_always_send_zeros(mode: Mode) -> None:
    bench = ready(QUIET)
    bench.run(60)
    bench.request(mode)
    assert not bench.state.silent
    for _ in range(200):
        assert sent(bench)


def test_a_fault_that_the_daemon_reports_ends_the_silence() -> None:
    bench = ready(QUIET)
    bench.run(60)
    bench.give(FaultReported(bench.t_ns, Cause.DAEMON_ENDS, "the daemon is stopping"))
    assert sent(bench)


def test_a_motion_ends_the_silence_and_a_second_after_it_comes_again() -> None:
    bench = ready(QUIET)
    bench.run(60)
    assert not start(bench)
    assert not bench.state.silent
    bench.run(3)
    bench.request(Mode.IDLE)
    bench.run(10)
    assert bench.state.mode is Mode.IDLE
    assert not bench.state.silent
    bench.run(60)
    assert bench.state.silent


def test_yield_lets_others_drive_in_idle_and_starts_once_they_are_quiet() -> None:
    bench = yielding()
    bench.give(CommandPublishersSeen(bench.t_ns, ("/nav2",)))
    bench.give(ForeignCommandHeard(bench.t_ns, "/nav2"))
    assert bench.state.mode is Mode.IDLE
    assert "/nav2 also published a velocity command" in start(bench)
    bench.run(51)
    assert not start(bench)
    bench.give(ForeignCommandHeard(bench.t_ns, "/nav2"))
    assert stopped_by(bench, Cause.FOREIGN_PUBLISHER, Mode.ERROR)


def test_warn_lets_the_motion_go_on() -> None:
    bench = ready(replace(KernelParams(), command=CommandParams(foreign=Foreign.WARN)))
    bench.give(CommandPublishersSeen(bench.t_ns, ("/nav2",)))
    assert not start(bench)
    bench.give(ForeignCommandHeard(bench.t_ns, "/nav2"))
    bench.run(1)
    assert bench.state.mode is Mode.MOVING


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


def is_asked_to_stand(bench: Bench) -> None:
    bench.request(Mode.IDLE.value)


def is_stopped(bench: Bench) -> None:
    bench.request(Mode.EMERGENCY_STOP.value)


def loses_odometry(bench: Bench) -> None:
    for _ in range(40):
        bench.tick()
        if bench.state.mode is not Mode.MOVING:
            return


@for_each("ends", [is_asked_to_stand, is_stopped, loses_odometry])
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


@for_each(("held_s", "is_over"), [(1.25, True), (1.24, False)])
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


@for_each("quiet_s", [-0.1, MAX_QUIET_S + 0.1, nan])
def test_a_silence_that_is_not_allowed_is_refused_by_its_limits(quiet_s: float) -> None:
    assert Held(0.1, 0.0, 1.0, quiet_s=quiet_s).refusal().endswith("use 0 to 5 s")
    assert Held(0.1, 0.0, 1.0, quiet_s=MAX_QUIET_S).refusal() == ""


def test_the_simulated_base_stops_by_its_own_timeout() -> None:
    result = drive_simulated(
        Pattern(), laps=1, course=Course(held=Held(0.1, 0.0, 1.0, quiet_s=2.0))
    )
    assert result.ended.report.distance_m == pytest.approx(0.15, abs=0.02)
