"""Late, wrong, repeated or foreign odometry ends in zero; setting the clock changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan

import pytest

from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import MIN_SIZE_M, Pattern, PatternKind
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.safety import remedies_for
from robotctl.kernel.types import (
    ZERO,
    Cause,
)
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


def test_no_start_before_the_first_odometry() -> None:
    bench = Bench()
    bench.battery(1.0)
    assert "no odometry was received on odom yet" in start(bench)


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


@pytest.mark.parametrize("lie", LIES)
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


@pytest.mark.parametrize("lie", LIES)
def test_one_sample_that_cannot_be_true_is_dropped(lie: str) -> None:
    bench = moving()
    before = bench.state.health.odometry
    LIES[lie](bench)
    assert bench.state.mode is Mode.MOVING
    assert bench.state.health.odometry == before
    bench.run(20)
    assert bench.state.mode is Mode.MOVING
    assert not bench.state.health.odometry_fault


@pytest.mark.parametrize("hours", [-1, 1])
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


@pytest.mark.parametrize("lie", LIES)
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


def test_a_turn_that_no_number_can_hold_is_a_jump() -> None:
    bench = Bench()
    bench.odometry(Pose(0.0, 0.0, -1e308))
    bench.odometry(Pose(0.0, 0.0, 1e308))
    assert "jumped by nan rad" in bench.state.health.odometry_fault


@pytest.mark.parametrize("lie", ["nan", "inf", "nan heading"])
def test_a_drive_never_begins_where_no_number_says(lie: str) -> None:
    bench = ready()
    before = bench.state.health.odometry
    LIES[lie](bench)
    assert bench.state.health.odometry == before
    assert not start(bench)
    assert bench.state.drive is not None
    assert bench.state.drive.origin == ORIGIN


@pytest.mark.parametrize("stamp_ns", [1, 10**18])
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


@pytest.mark.parametrize("moves", [True, False])
def test_odometry_without_stamps_and_with_coarse_ones_is_news(moves: bool) -> None:
    bench = moving()
    for number in range(40):
        bench.odometry(Pose(number * 1e-4, 0.0, 0.0) if moves else Pose(), 7 if moves else 0)
        bench.battery(1.0)
        bench.tick()
    assert bench.state.mode is Mode.MOVING


def test_a_robot_that_does_not_follow_is_stopped() -> None:
    bench = moving(ticks=0)
    bench.run(150)  # at the same pose
    assert stopped_by(bench, Cause.TRACKING_LOST, Mode.ERROR)
    assert "m from where it should be, more than 0.5 m" in bench.state.reason


def test_a_robot_that_did_not_follow_may_start_again_from_where_it_is() -> None:
    bench = moving(ticks=0)
    bench.run(150)
    assert reset(bench)
    assert not start(bench)


@pytest.mark.parametrize("kind", PatternKind)
def test_a_robot_that_stands_still_is_stopped_on_the_smallest_pattern_too(
    kind: PatternKind,
) -> None:
    bench = ready()
    bench.drive(Pattern(kind, MIN_SIZE_M))
    for _ in while_moving(bench):
        bench.run(1)
    assert stopped_by(bench, Cause.TRACKING_LOST, Mode.ERROR)
    assert "than the pattern is large" in bench.state.reason
