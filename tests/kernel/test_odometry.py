"""Late, wrong, repeated or foreign odometry ends in zero; setting the clock changes nothing.

The robot follows one publisher of odometry; a second one is named and its data are not used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf, nan

import pytest

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.odometry import MAX_NAMED_SOURCES
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import MIN_SIZE_M, Pattern, PatternKind
from robotctl.kernel.safety import remedies_for
from robotctl.kernel.types import ZERO, Cause, Odometry, OdometrySourceFound, OdomReceived, Remedy
from robotctl.testing.kernels import (
    TICK_NS,
    Bench,
    moving,
    ready,
    reset,
    start,
    stopped_by,
    while_moving,
)
from tests.support.cases import for_each


def test_lost_odometry_means_zero_within_its_timeout_and_one_tick() -> None:
    bench = moving(ticks=50)
    lost_ns = bench.t_ns - TICK_NS
    assert bench.state.command != ZERO
    for _ in while_moving(bench):
        bench.battery(1.0)
        bench.tick()
    assert stopped_by(bench, Cause.ODOMETRY_LOST, Mode.ERROR)
    assert bench.t_ns - lost_ns <= 500_000_000 + TICK_NS


LIES: dict[str, Callable[[Bench], None]] = {
    "nan": lambda bench: _odometry(bench, Pose(nan, 0.0, 0.0)),
    "inf": lambda bench: _odometry(bench, Pose(0.0, -inf, 0.0)),
    "nan heading": lambda bench: _odometry(bench, Pose(0.0, 0.0, nan)),
    "jump": lambda bench: _odometry(bench, Pose(3.0, 0.0, 0.0)),
    "huge": lambda bench: _odometry(bench, Pose(-1e308, 1e308, 0.0)),
    "turned around": lambda bench: _odometry(bench, Pose(0.0, 0.0, 3.0)),
    "turned beyond measure": lambda bench: _odometry(bench, Pose(0.0, 0.0, 1e308)),
    "back in time": lambda bench: _odometry(bench, Pose(), -bench.t_ns),
}


def _odometry(bench: Bench, pose: Pose, stamp_ns: int | None = None) -> None:
    bench.odometry(pose, stamp_ns)


@for_each("lie", LIES)
def test_odometry_that_cannot_be_true_means_zero_within_its_timeout_and_one_tick(lie: str) -> None:
    bench = moving()
    last_ns = bench.t_ns - TICK_NS
    for _ in while_moving(bench):
        LIES[lie](bench)
        assert bench.state.health.odometry_fault
        bench.battery(1.0)
        bench.tick()
    assert stopped_by(bench, Cause.ODOMETRY_WRONG, Mode.ERROR)
    assert bench.t_ns - last_ns <= 500_000_000 + TICK_NS
    assert remedies_for(bench.state.cause) == (Remedy.CHECK_ODOMETRY_SOURCE,)


@for_each("lie", LIES)
def test_one_sample_that_cannot_be_true_is_dropped(lie: str) -> None:
    bench = moving()
    before = bench.state.health.odometry
    LIES[lie](bench)
    assert bench.state.mode is Mode.MOVING
    assert bench.state.health.odometry == before
    bench.run(20)
    assert bench.state.mode is Mode.MOVING
    assert not bench.state.health.odometry_fault


@for_each("hours", [-1, 1])
def test_a_jump_of_the_wall_clock_changes_nothing(hours: int) -> None:
    shift_ns, steady, jumped = hours * 3_600_000_000_000, moving(), moving()
    for number in range(40):
        for bench in (steady, jumped):
            stamp_ns = bench.t_ns + (shift_ns if bench is jumped and number >= 10 else 0)
            bench.odometry(Pose(), stamp_ns)
            bench.battery(1.0)
            bench.tick()
    assert jumped.state.mode is Mode.MOVING
    assert jumped.commands == steady.commands


@for_each("lie", LIES)
def test_no_start_on_odometry_that_is_never_true(lie: str) -> None:
    bench = ready()
    for number in range(60):
        # As if two robots reported, or a stamp ran backwards.
        if number % 2 or lie not in ("jump", "huge", "turned around", "turned beyond measure"):
            LIES[lie](bench)
        else:
            bench.odometry(Pose())
        bench.battery(1.0)
        bench.tick()
        if lie == "back in time":
            bench.t_ns += 1
    assert "odometry" in start(bench)


def test_after_a_jump_the_robot_starts_from_where_it_is_now() -> None:
    bench = moving()
    elsewhere = Pose(5.0, 5.0, 2.0)
    for _ in while_moving(bench):
        bench.odometry(elsewhere)
        bench.battery(1.0)
        bench.tick()
    for _ in range(2):
        bench.odometry(elsewhere)
        bench.battery(1.0)
        bench.tick()
    assert reset(bench)
    assert not start(bench)
    assert bench.state.drive is not None
    assert bench.state.drive.origin == elsewhere


@for_each("stamp_ns", [1, 10**18])
def test_odometry_that_is_only_repeated_means_zero_within_its_timeout_and_one_tick(
    stamp_ns: int,
) -> None:
    bench = moving()
    bench.odometry(Pose(), stamp_ns)
    bench.odometry(Pose(), stamp_ns)
    last_ns = bench.t_ns
    for _ in while_moving(bench):
        bench.odometry(Pose(), stamp_ns)
        bench.battery(1.0)
        bench.tick()
    assert stopped_by(bench, Cause.ODOMETRY_LOST, Mode.ERROR)
    assert bench.t_ns - last_ns <= 500_000_000 + TICK_NS


@for_each("moves", [True, False])
def test_odometry_without_stamps_and_with_coarse_ones_is_news(moves: bool) -> None:
    bench = moving()
    for number in range(40):
        bench.odometry(Pose(number * 1e-4, 0.0, 0.0) if moves else Pose(), 7 if moves else 0)
        bench.battery(1.0)
        bench.tick()
    assert bench.state.mode is Mode.MOVING


def test_a_robot_that_does_not_follow_is_stopped_and_may_start_from_where_it_is() -> None:
    bench = moving(ticks=0)
    bench.run(150)  # at the same pose
    assert stopped_by(bench, Cause.TRACKING_LOST, Mode.ERROR)
    assert "m from where it should be, more than 0.5 m" in bench.state.reason
    assert reset(bench)
    assert not start(bench)


@for_each("kind", PatternKind)
def test_a_robot_that_stands_still_is_stopped_on_the_smallest_pattern_too(
    kind: PatternKind,
) -> None:
    bench = ready()
    bench.drive(Pattern(kind, MIN_SIZE_M))
    for _ in while_moving(bench):
        bench.run(1)
    assert stopped_by(bench, Cause.TRACKING_LOST, Mode.ERROR)
    assert "than the pattern is large" in bench.state.reason


FAR = Pose(10.0, 0.0, 0.0)
TURNED = Pose(0.0, 0.0, 2.0)
NEAR = Pose(0.01, 0.0, 0.0)


def sample(bench: Bench, source: int, pose: Pose) -> None:
    bench.give(OdomReceived(bench.t_ns, Odometry(pose, ZERO, bench.t_ns), source, 1))


def bench_of_two(ticks: int = 3, params: KernelParams | None = None) -> Bench:
    """Return a kernel in IDLE that follows /base and knows /other."""
    bench = Bench(params)
    for number, name in ((1, "/base"), (2, "/other")):
        bench.give(OdometrySourceFound(bench.t_ns, number, f"{number:032x}", name))
    go_on(bench, ticks)
    return bench


def go_on(bench: Bench, ticks: int = 1) -> None:
    for _ in range(ticks):
        sample(bench, 1, ORIGIN)
        bench.battery(1.0)
        bench.tick()


@for_each("pose", [FAR, NEAR])
def test_a_second_publisher_of_odometry_is_a_failed_start_condition(pose: Pose) -> None:
    bench = bench_of_two()
    sample(bench, 2, pose)
    assert "two publishers, /base and /other" in start(bench)
    assert bench.state.mode is Mode.IDLE
    assert bench.state.health.odometry.pose == ORIGIN  # type: ignore[union-attr]


@for_each("pose", [FAR, TURNED, Pose(float("nan"), 0.0, 0.0)])
def test_in_moving_a_second_publisher_that_contradicts_the_first_stops_the_robot(
    pose: Pose,
) -> None:
    bench = bench_of_two()
    assert not start(bench)
    go_on(bench, 5)
    sample(bench, 2, pose)
    assert stopped_by(bench, Cause.ODOMETRY_CONTRADICTED, Mode.ERROR)
    assert "/base and /other" in bench.state.reason
    assert not reset(bench)
    go_on(bench, 26)
    assert reset(bench)


def test_in_moving_a_second_publisher_that_agrees_is_counted_and_not_used() -> None:
    bench = bench_of_two()
    assert not start(bench)
    go_on(bench, 5)
    sample(bench, 2, NEAR)
    assert bench.state.mode is Mode.MOVING
    health = bench.state.health
    assert health.odometry.pose == ORIGIN  # type: ignore[union-attr]
    assert health.odometry_sources.dropped == 1


def test_a_standing_robot_follows_another_publisher_once_the_first_is_silent() -> None:
    bench = bench_of_two()
    bench.t_ns += round(0.6 * NS_PER_S)
    for _ in range(3):
        sample(bench, 2, FAR)
        bench.battery(1.0)
        bench.tick()
    assert bench.state.health.odometry_sources.followed == 2
    assert not start(bench)


def test_a_moving_robot_follows_no_other_publisher() -> None:
    bench = bench_of_two()
    assert not start(bench)
    for _ in range(30):  # the first is silent
        sample(bench, 2, NEAR)
        bench.battery(1.0)
        bench.tick()
    assert bench.state.mode is Mode.ERROR
    assert bench.state.cause is Cause.ODOMETRY_LOST


def test_a_publisher_that_was_followed_before_is_not_followed_beside_its_successor() -> None:
    bench = bench_of_two()
    bench.t_ns += round(0.6 * NS_PER_S)
    sample(bench, 2, FAR)  # taken as a jump
    bench.t_ns += 1
    sample(bench, 2, FAR)
    sample(bench, 1, ORIGIN)
    health = bench.state.health
    assert health.odometry_sources.followed == 2
    assert health.odometry.pose == FAR  # type: ignore[union-attr]


def test_samples_that_cannot_be_true_are_counted() -> None:
    bench = bench_of_two()
    sample(bench, 1, Pose(float("inf"), 0.0, 0.0))
    assert bench.state.health.odometry_sources.dropped == 1
    assert bench.state.health.odometry_fault == "odometry is not finite"


def in_frame(frame: str, wanted: str) -> Bench:
    """Return a moving kernel whose followed odometry names this frame from now on."""
    odometry = replace(KernelParams().odometry, frame_id=wanted)
    bench = moving(replace(KernelParams(), odometry=odometry))
    bench.give(OdometrySourceFound(bench.t_ns, 0, "", "/base", frame))
    return bench


@for_each("frame", ["map", "world"])
def test_odometry_of_another_frame_than_the_configured_one_stops_the_robot(frame: str) -> None:
    bench = in_frame(frame, "odom")
    assert stopped_by(bench, Cause.ODOMETRY_WRONG, Mode.ERROR)
    assert (
        bench.state.reason == f"odometry is in the frame {frame}, not in odom (odometry.frame_id)"
    )
    assert not reset(bench)
    bench.give(OdometrySourceFound(bench.t_ns, 0, "", "/base", "odom"))
    assert reset(bench)


@for_each(("frame", "wanted"), [("odom", "odom"), ("r2/odom", ""), ("", "odom")])
def test_the_configured_frame_and_one_that_is_unknown_stop_nothing(frame: str, wanted: str) -> None:
    assert in_frame(frame, wanted).state.mode is Mode.MOVING


@for_each("other", [0, 2])
def test_only_the_frame_of_the_followed_publisher_counts(other: int) -> None:
    odometry = replace(KernelParams().odometry, frame_id="odom")
    bench = bench_of_two(params=replace(KernelParams(), odometry=odometry))
    assert bench.state.health.odometry_sources.followed == 1
    bench.give(OdometrySourceFound(bench.t_ns, other, "", "/other", "map"))
    assert not start(bench)


def test_the_names_and_frames_of_the_last_publishers_are_kept() -> None:
    bench, last = moving(), MAX_NAMED_SOURCES + 3
    for number in range(1, last + 1):
        bench.give(OdometrySourceFound(bench.t_ns, number, "", f"/n{number}", f"f{number}"))
    sources = bench.state.health.odometry_sources
    wanted = range(last - MAX_NAMED_SOURCES + 1, last + 1)
    assert sources.names == tuple((number, f"/n{number}") for number in wanted)
    assert sources.frames == tuple((number, f"f{number}") for number in wanted)


def test_a_publisher_that_names_another_frame_is_in_that_one_alone() -> None:
    bench = moving()
    for number in (1, 2, 3):
        bench.give(OdometrySourceFound(bench.t_ns, number, "", f"/n{number}", "odom"))
    bench.give(OdometrySourceFound(bench.t_ns, 2, "", "/n2", "map"))
    frames = bench.state.health.odometry_sources.frames
    assert frames == ((1, "odom"), (3, "odom"), (2, "map"))


def test_two_publishers_that_agree_on_a_turned_robot_do_not_contradict_each_other() -> None:
    bench = Bench()
    for number in (1, 2):
        bench.give(OdometrySourceFound(bench.t_ns, number, "", f"/n{number}"))
    sample(bench, 1, TURNED)
    sample(bench, 2, replace(TURNED, theta=TURNED.theta - 0.1))
    second = bench.state.health.odometry_sources.second
    assert second is not None
    assert second.distance_m == 0.0
    assert second.angle_rad == pytest.approx(0.1)
