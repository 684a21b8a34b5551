"""The robot follows one publisher of odometry; a second one is named and its data are not used."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.odometry import MAX_NAMED_SOURCES
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import (
    ZERO,
    Cause,
    Odometry,
    OdometrySourceFound,
    OdomReceived,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.testing.kernels import Bench, moving, reset, start, stopped_by

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


@pytest.mark.parametrize("pose", [FAR, NEAR])
def test_a_second_publisher_of_odometry_is_a_failed_start_condition(pose: Pose) -> None:
    bench = bench_of_two()
    sample(bench, 2, pose)
    assert "two publishers, /base and /other" in start(bench)
    assert bench.state.mode is Mode.IDLE
    assert bench.state.health.odometry.pose == ORIGIN  # type: ignore[union-attr]


def test_the_start_is_free_again_once_the_second_publisher_is_silent_for_the_timeout() -> None:
    bench = bench_of_two()
    sample(bench, 2, FAR)
    go_on(bench, 26)  # 0.52 s
    assert not start(bench)


@pytest.mark.parametrize("pose", [FAR, TURNED, Pose(float("nan"), 0.0, 0.0)])
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


def test_an_orientation_that_is_none_is_dropped_and_named() -> None:
    bench = bench_of_two()
    sample(bench, 1, Pose(0.0, 0.0, float("nan")))
    assert "no valid orientation" in bench.state.health.odometry_fault
    assert bench.state.health.odometry.pose == ORIGIN  # type: ignore[union-attr]


def in_frame(frame: str, wanted: str) -> Bench:
    """Return a moving kernel whose followed odometry names this frame from now on."""
    odometry = replace(KernelParams().odometry, frame_id=wanted)
    bench = moving(replace(KernelParams(), odometry=odometry))
    bench.give(OdometrySourceFound(bench.t_ns, 0, "", "/base", frame))
    return bench


@pytest.mark.parametrize("frame", ["map", "world"])
def test_odometry_of_another_frame_than_the_configured_one_stops_the_robot(frame: str) -> None:
    bench = in_frame(frame, "odom")
    assert stopped_by(bench, Cause.ODOMETRY_WRONG, Mode.ERROR)
    assert (
        bench.state.reason == f"odometry is in the frame {frame}, not in odom (odometry.frame_id)"
    )
    assert not reset(bench)
    bench.give(OdometrySourceFound(bench.t_ns, 0, "", "/base", "odom"))
    assert reset(bench)


@pytest.mark.parametrize(("frame", "wanted"), [("odom", "odom"), ("r2/odom", ""), ("", "odom")])
def test_the_configured_frame_and_one_that_is_unknown_stop_nothing(frame: str, wanted: str) -> None:
    assert in_frame(frame, wanted).state.mode is Mode.MOVING


@pytest.mark.parametrize("other", [0, 2])
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
