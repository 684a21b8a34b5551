"""A guarded motion: another node wants velocities; limits, silence and every rule still hold."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from robotctl.kernel.geometry import Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import Guarded
from robotctl.kernel.types import (
    ZERO,
    Cause,
    ForeignCommandHeard,
    GuardedCommandReceived,
    LoopStalled,
    Twist,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.testing.kernels import Bench, ready, stopped_by

GUARDING = replace(KernelParams(), guard=True)


def wanted(bench: Bench, twist: Twist, ticks: int = 1) -> None:
    """Let another node want this velocity at each tick."""
    for _ in range(ticks):
        bench.give(GuardedCommandReceived(bench.t_ns, twist))
        bench.run(1)


def guarding(params: KernelParams = GUARDING) -> Bench:
    bench = ready(params)
    bench.request(Mode.MOVING)
    assert bench.replies[-1].message == "Mode changed to MOVING: guarding cmd_vel_nav"
    assert bench.state.command == ZERO
    return bench


def test_what_another_node_wants_is_commanded_within_the_limits() -> None:
    bench = guarding()
    wanted(bench, Twist(0.2, -0.4), ticks=30)
    assert bench.state.command == Twist(0.2, -0.4)
    wanted(bench, Twist(5.0, 9.0), ticks=100)
    limits = bench.kernel.params.limits
    assert bench.state.command == Twist(limits.linear_mps, limits.angular_rps)
    steps = [b.linear - a.linear for a, b in zip(bench.commands, bench.commands[1:], strict=False)]
    assert max(steps) <= limits.linear_accel_mps2 * 0.02 + 1e-9


def test_the_silence_is_counted_from_the_last_velocity_whatever_the_clock_shows() -> None:
    early = Guarded(Twist(0.3, 0.0), NS_PER_S)
    assert early.wanted(NS_PER_S + NS_PER_S // 2, 0.5) == Twist(0.3, 0.0)
    assert early.wanted(3 * NS_PER_S, 0.5) is None
    assert early.wanted(0, 0.5) is None


def test_a_silence_of_a_quarter_of_a_second_is_zero_at_once() -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    bench.run(11)  # 0.24 s
    assert bench.state.command.linear > 0.0
    bench.run(2)
    assert (bench.state.mode, bench.state.command) == (Mode.MOVING, ZERO)
    wanted(bench, Twist(0.3, 0.0), ticks=1)
    assert 0.0 < bench.state.command.linear <= 0.02 + 1e-9


@pytest.mark.parametrize("number", [nan, inf, -inf])
def test_a_velocity_that_is_no_number_is_zero(number: float) -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.1), ticks=30)
    wanted(bench, Twist(number, 0.1))
    assert bench.state.command == ZERO
    wanted(bench, Twist(0.3, 0.1), ticks=30)
    wanted(bench, Twist(0.3, number))
    assert bench.state.command == ZERO


def test_the_rules_of_the_safety_table_stop_a_guarded_motion() -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    bench.give(ForeignCommandHeard(bench.t_ns, "/joystick"))
    assert stopped_by(bench, Cause.FOREIGN_PUBLISHER, Mode.ERROR)
    wanted(bench, Twist(0.3, 0.0), ticks=10)
    assert bench.state.command == ZERO
    assert bench.state.guarded is None


@pytest.mark.parametrize(
    ("field", "value"), [("battery", 0.1), ("odometry", Pose(nan, 0.0, 0.0)), ("stall", 1.0)]
)
def test_a_guarded_motion_ends_as_any_other(field: str, value: object) -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    if isinstance(value, Pose):
        for _ in range(40):
            bench.give(GuardedCommandReceived(bench.t_ns, Twist(0.3, 0.0)))
            bench.odometry(value)
            bench.tick()
    elif field == "battery":
        bench.battery(0.1)
    else:
        bench.give(LoopStalled(bench.t_ns, 1.0, 10, 0, "a test"))
    assert bench.state.mode in (Mode.ERROR, Mode.EMERGENCY_STOP)
    assert bench.state.command == ZERO


def test_a_request_for_idle_ramps_a_guarded_motion_down() -> None:
    bench = guarding()
    wanted(bench, Twist(0.3, 0.0), ticks=30)
    bench.request(Mode.IDLE)
    wanted(bench, Twist(0.3, 0.0), ticks=50)
    assert (bench.state.mode, bench.state.command) == (Mode.IDLE, ZERO)
    assert bench.replies[-1].ok


def test_outside_of_a_guarded_motion_nothing_that_others_want_is_commanded() -> None:
    bench = ready(GUARDING)
    wanted(bench, Twist(0.3, 0.0), ticks=10)
    assert bench.state.command == ZERO
    bench.drive()
    before = bench.state.drive
    wanted(bench, Twist(-0.6, 1.0), ticks=20)
    assert before is not None
    assert bench.state.command.linear >= 0.0
    bench.drive(replacing=True)
    assert bench.state.guarded is None
