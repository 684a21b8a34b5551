"""Each limit lies exactly at its documented number: allowed at it, refused just beyond."""

from __future__ import annotations

from dataclasses import replace
from math import nan, pi

import pytest

from robotctl.kernel.course import Course, Held
from robotctl.kernel.drive import Progress
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.odometry import dropped, is_repeated, may_follow, odometry_fault
from robotctl.kernel.params import BatteryParams, BatteryScale, KernelParams, OdometryParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.safety import uncleared
from robotctl.kernel.state import Health, OdometrySources, SecondOdometry, full_level
from robotctl.kernel.types import (
    ZERO,
    Cause,
    DriveEnded,
    ForeignCommandHeard,
    Odometry,
    OdomReceived,
    PublishTwist,
    Reply,
    Tick,
    Twist,
)
from robotctl.testing.kernels import moving, ready, start, stopping
from tests.support.cases import for_each

NOW_NS = 100_000_000_000
PARAMS = KernelParams()


def odometry(pose: Pose = ORIGIN, stamp_ns: int = NOW_NS) -> Odometry:
    return Odometry(pose, ZERO, stamp_ns)


HEALTHY = Health(odometry=odometry(), odometry_t_ns=NOW_NS, battery_level=1.0, battery_t_ns=NOW_NS)


def hindered(cause: Cause, health: Health) -> bool:
    return uncleared(cause, health, PARAMS, NOW_NS) is not None


@for_each("way", [1, -1])
def test_odometry_is_lost_after_half_a_second(way: int) -> None:
    for age_ns, is_lost in ((500_000_000, False), (500_000_001, True)):
        health = replace(HEALTHY, odometry_t_ns=NOW_NS - way * age_ns)
        assert hindered(Cause.ODOMETRY_LOST, health) is is_lost
        wrong = replace(health, odometry_fault="odometry is not finite")
        assert hindered(Cause.ODOMETRY_WRONG, wrong) is is_lost


def test_a_battery_is_unknown_after_5_s() -> None:
    for age_ns, is_unknown in ((5_000_000_000, False), (5_000_000_001, True)):
        health = replace(HEALTHY, battery_t_ns=NOW_NS - age_ns)
        assert hindered(Cause.BATTERY_UNKNOWN, health) is is_unknown


def test_a_level_from_empty_to_a_gauge_that_overshoots_by_5_percent_is_known() -> None:
    for level in (-0.001, 0.0, 0.3, 1.0, 1.05, 1.051, nan):
        is_known = not hindered(Cause.BATTERY_UNKNOWN, replace(HEALTHY, battery_level=level))
        assert is_known is (0.0 <= level <= 1.05), level


@for_each(("level", "is_cleared"), [(0.19, False), (0.2, True), (0.9, True)])
def test_a_battery_has_cleared_at_20_percent_and_above(level: float, is_cleared: bool) -> None:
    assert hindered(Cause.BATTERY_LOW, replace(HEALTHY, battery_level=level)) is not is_cleared


@for_each(("raw", "level"), [(1.05, 1.05), (1.06, 0.0106), (105.0, 1.05), (105.1, 105.1)])
def test_a_gauge_counts_in_percent_where_it_reports_more_than_full_and_up_to_105(
    raw: float, level: float
) -> None:
    bench = ready(replace(PARAMS, battery=BatteryParams(scale=BatteryScale.AUTO)))
    bench.battery(raw)
    assert bench.state.health.battery_level == pytest.approx(level)


def test_a_full_battery_is_1_or_100() -> None:
    assert [full_level(scale) for scale in BatteryScale] == [
        100.0 if scale is BatteryScale.PERCENT else 1.0 for scale in BatteryScale
    ]


def test_a_foreign_command_hinders_motion_for_1_s() -> None:
    for age_ns, hinders in ((1_000_000_000, True), (1_000_000_001, False)):
        bench = ready()
        bench.give(ForeignCommandHeard(bench.t_ns - age_ns, "/teleop"))
        assert bool(start(bench)) is hinders


@for_each(
    ("pose", "fault"),
    [
        (Pose(0.5, 0.0, 0.0), ""),
        (Pose(0.501, 0.0, 0.0), "odometry jumped by 0.50 m"),
        (Pose(0.0, 0.0, -1.0), ""),
        (Pose(0.0, 0.0, -1.001), "odometry jumped by 1.00 rad"),
    ],
)
def test_odometry_jumps_by_more_than_half_a_metre_or_1_rad(pose: Pose, fault: str) -> None:
    assert odometry_fault(HEALTHY, odometry(pose), OdometryParams()) == fault


def test_a_stamp_may_stand_still_and_not_go_back() -> None:
    health = replace(HEALTHY, odometry_stamp_ns=7)
    assert odometry_fault(health, odometry(stamp_ns=7), OdometryParams()) == ""
    assert odometry_fault(health, odometry(stamp_ns=6), OdometryParams())


@for_each(("stamp_ns", "is_known"), [(-1, True), (0, False), (1, True)])
def test_a_sample_without_a_stamp_is_never_a_repeated_one(stamp_ns: int, is_known: bool) -> None:
    sample = odometry(stamp_ns=stamp_ns)
    assert is_repeated(replace(HEALTHY, odometry=sample), sample) is is_known


@for_each("number", range(5))
def test_each_number_of_odometry_must_be_finite(number: int) -> None:
    x, y, theta, linear, angular = (nan if each == number else 0.0 for each in range(5))
    sample = Odometry(Pose(x, y, theta), Twist(linear, angular), NOW_NS)
    said = "no valid orientation" if number == 2 else "not finite"
    assert said in odometry_fault(HEALTHY, sample, OdometryParams())


@for_each("way", [1, -1])
def test_another_publisher_is_followed_after_half_a_second_of_silence(way: int) -> None:
    event = OdomReceived(NOW_NS, odometry(), source=2)
    for age_ns, follows in ((500_000_000, False), (500_000_001, True)):
        health = replace(HEALTHY, odometry_t_ns=NOW_NS - way * age_ns)
        assert may_follow(health, event, OdometryParams()) is follows
    assert may_follow(replace(HEALTHY, odometry=None), event, OdometryParams())


def test_a_second_publisher_before_the_first_sample_contradicts_nothing() -> None:
    event = OdomReceived(NOW_NS, odometry(Pose(9.0, 9.0, 2.0)), source=2)
    sources = dropped(Health(), event)
    assert sources.second == SecondOdometry(2, NOW_NS, 0.0, 0.0)
    assert sources.dropped == 1


def test_a_second_publisher_hinders_a_start_for_half_a_second() -> None:
    for age_ns, hinders in ((500_000_000, True), (500_000_001, False)):
        second = SecondOdometry(2, NOW_NS - age_ns, 9.0, 0.0)
        health = replace(HEALTHY, odometry_sources=OdometrySources(second=second))
        assert hindered(Cause.SECOND_ODOMETRY, health) is hinders
        assert hindered(Cause.ODOMETRY_CONTRADICTED, health) is hinders


@for_each(
    ("distance_m", "angle_rad", "contradicts"),
    [(0.5, 1.0, False), (0.51, 0.0, True), (0.0, 1.01, True), (nan, 0.0, True), (0.0, nan, True)],
)
def test_a_second_publisher_contradicts_from_where_odometry_would_jump(
    distance_m: float, angle_rad: float, contradicts: bool
) -> None:
    second = SecondOdometry(2, NOW_NS, distance_m, angle_rad)
    health = replace(HEALTHY, odometry_sources=OdometrySources(second=second))
    assert hindered(Cause.ODOMETRY_CONTRADICTED, health) is contradicts


def test_tracking_is_lost_beyond_half_a_metre() -> None:
    assert not hindered(Cause.TRACKING_LOST, replace(HEALTHY, path_error_m=0.5))
    assert hindered(Cause.TRACKING_LOST, replace(HEALTHY, path_error_m=0.501))


def test_a_robot_that_ramps_down_has_no_error_to_a_reference_that_stands() -> None:
    bench = stopping()
    bench.odometry(Pose(0.2, 0.0, 0.0))
    assert bench.state.health.path_error_m == 0.0
    bench = moving()
    bench.odometry(Pose(0.2, 0.0, 0.0))
    assert bench.state.health.path_error_m > 0.1
    bench.request(Mode.ERROR)
    assert bench.state.health.path_error_m == 0.0


@for_each("way", [1, -1])
def test_a_tick_may_be_300_ms_late(way: int) -> None:
    for gap_ns, stops in ((300_000_000, False), (300_000_001, True)):
        bench = moving()
        bench.give(Tick((bench.state.tick_t_ns or 0) + way * gap_ns))
        assert (bench.state.cause is Cause.TICK_OVERRUN) is stops


def test_a_late_tick_changes_the_command_by_what_two_periods_allow() -> None:
    bench = moving(ticks=30)
    bench.kernel.state = replace(bench.state, command=ZERO)
    (effect,) = bench.give(Tick(bench.t_ns + 200_000_000))
    assert isinstance(effect, PublishTwist)
    assert effect.twist.linear == pytest.approx(1.0 * 2 / 50)


@for_each(("held", "passed_s"), [(None, 2 / 50), (Held(0.3, 0.0, 5.0), 0.2)])
def test_a_late_tick_moves_the_reference_by_two_periods_and_a_held_velocity_by_the_clock(
    held: Held | None, passed_s: float
) -> None:
    bench = ready()
    bench.drive(Pattern(PatternKind.LINE, 3.0), course=Course(held=held))
    bench.run(20)
    before = bench.state.drive
    assert before is not None
    bench.give(Tick(bench.t_ns + 200_000_000))
    assert bench.state.drive is not None
    progress = bench.state.drive.progress
    per_s = 1.0 if held is not None else progress.speed
    assert progress.length - before.progress.length == pytest.approx(per_s * passed_s)


@for_each("back_ns", [0, 100_000_000])
def test_a_tick_that_is_not_later_than_the_one_before_leaves_the_command(back_ns: int) -> None:
    bench = moving()
    command = bench.state.command
    assert bench.give(Tick((bench.state.tick_t_ns or 0) - back_ns)) == (PublishTwist(command),)


def test_64_requests_wait_for_a_ramp_and_one_more_is_refused() -> None:
    bench = moving()
    for _ in range(64):
        assert bench.request(Mode.IDLE) == ()
    bench.request(Mode.IDLE)
    assert not bench.replies[-1].ok
    bench.kernel.state = replace(bench.state, waiting=tuple(range(100, 200)))
    (reply,) = bench.request(Mode.IDLE)
    assert isinstance(reply, Reply)
    assert not reply.ok


@for_each(("laps", "is_allowed"), [(-1, False), (0, True), (100_000, True), (100_001, False)])
def test_a_drive_has_up_to_100_000_laps(laps: int, is_allowed: bool) -> None:
    bench = ready()
    bench.drive(laps=laps)
    assert bench.replies[-1].ok is is_allowed


@for_each(("laps", "said"), [(1, "1 lap"), (2, "2 laps")])
def test_a_drive_that_ends_tells_its_laps(laps: int, said: str) -> None:
    bench = moving(ticks=0)
    drive = bench.state.drive
    assert drive is not None
    ended = replace(drive, laps=laps, progress=Progress(laps=laps - 1, segment=7, length=pi / 2))
    bench.kernel.state = replace(bench.state, drive=ended)
    bench.run(40)
    (effect,) = (each for each in bench.effects if isinstance(each, DriveEnded))
    assert effect.completed
    assert effect.reason == f"drive finished: {said}"


@for_each("kind", PatternKind)
def test_a_request_for_moving_drives_until_it_is_stopped_or_to_the_end_of_a_line(
    kind: PatternKind,
) -> None:
    pattern = Pattern(kind)
    drive = moving(replace(PARAMS, pattern=pattern), ticks=0).state.drive
    assert drive is not None
    has_end = kind in (PatternKind.LINE, PatternKind.ARC, PatternKind.TURN)
    assert drive.laps == (1 if has_end else 0)
    assert drive.pattern == pattern


@for_each("reverse", [False, True])
def test_a_drive_that_replaces_another_one_begins_at_the_speed_in_its_direction(
    reverse: bool,
) -> None:
    bench, line = ready(), Pattern(PatternKind.LINE, 3.0)
    bench.drive(line, course=Course(reverse=reverse))
    bench.run(30)
    command = bench.state.command.linear
    speed = -command if reverse else command
    assert speed > 0.3
    bench.drive(line, course=Course(reverse=reverse), replacing=True)
    assert bench.state.drive is not None
    begun = bench.state.drive.progress
    assert begun.speed == begun.lead_speed == speed
    assert begun.ahead == pytest.approx(0.5 * speed * 3 * 0.02)
    bench.drive(line, course=Course(reverse=not reverse), replacing=True)
    assert bench.state.drive.progress.speed == 0.0


def test_a_drive_begins_without_speed_and_never_backwards() -> None:
    drive = moving(ticks=0).state.drive
    assert drive is not None
    assert drive.progress == Progress(closure_m=drive.progress.closure_m)
    bench = moving(ticks=5)
    kernel = Kernel(PARAMS, replace(bench.state, command=Twist(-0.3, 0.0)))
    bench.kernel = kernel
    bench.drive(replacing=True)
    assert bench.state.drive is not None
    assert bench.state.drive.progress.speed == 0.0


@for_each(
    ("rise_s", "rate_hz", "ticks"),
    [(0.0, 50.0, 1), (0.01, 50.0, 1), (0.08, 50.0, 4), (0.08, 100, 8)],
)
def test_an_acceleration_builds_up_over_the_ticks_of_its_time_and_over_one_at_least(
    rise_s: float, rate_hz: float, ticks: int
) -> None:
    limits = replace(PARAMS.limits, accel_rise_s=rise_s)
    drive = moving(replace(PARAMS, limits=limits, rate_hz=rate_hz), ticks=12).state.drive
    assert drive is not None
    assert len(drive.progress.rates) == ticks
