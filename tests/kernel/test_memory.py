"""A step keeps all fields that it does not change, although states are built field by field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import Cause, CommandPublishersSeen, FaultReported
from robotctl.testing.kernels import Bench, in_mode, stopping

SITUATIONS: dict[str, Callable[[], Bench]] = {
    "stopping": stopping,
    "in error": lambda: in_mode(Mode.ERROR),
    "standing beside others": lambda: beside_others(in_mode(Mode.IDLE)),
}


def beside_others(bench: Bench) -> Bench:
    bench.give(CommandPublishersSeen(bench.t_ns, ("/teleop",)))
    bench.give(FaultReported(bench.t_ns, Cause.DAEMON_ENDS, "told to stop"))
    bench.t_ns += 400_000_000
    bench.battery(0.9)  # learned in a gap between ticks
    assert bench.state.health.tick_gap_s
    return bench


@pytest.mark.parametrize("situation", SITUATIONS)
def test_odometry_changes_what_is_known_of_odometry_alone(situation: str) -> None:
    bench = SITUATIONS[situation]()
    before = bench.state
    bench.odometry(Pose(0.01, 0.0, 0.0))
    after = bench.state
    assert replace(after, health=before.health, drive=before.drive) == before
    told = ("odometry", "odometry_t_ns", "odometry_stamp_ns", "path_error_m")
    assert (
        replace(after.health, **{name: getattr(before.health, name) for name in told})
        == before.health
    )


@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_tick_changes_command_and_drive_alone(situation: str) -> None:
    bench = SITUATIONS[situation]()
    before = bench.state
    bench.t_ns = before.tick_t_ns or 0
    bench.tick()
    after = bench.state
    assert after.mode is before.mode
    changed = {name: getattr(before, name) for name in ("command", "tick_t_ns", "drive", "health")}
    assert replace(after, **changed) == before
    assert replace(after.health, tick_gap_s=before.health.tick_gap_s) == before.health
