"""A command is finite and within its limits for every target."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.tracking import clamp, limit, within
from robotctl.kernel.types import ZERO, Cause, Tick, Twist
from robotctl.testing.kernels import moving

LIMITS = VelocityLimits(1.0, 2.0, 0.5, 4.0)


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_what_is_not_finite_becomes_zero_never_full_speed(value: float) -> None:
    assert clamp(value, 1.0) == 0.0
    assert limit(ZERO, Twist(value, value), 10.0, LIMITS) == ZERO


def test_a_command_changes_no_faster_than_allowed() -> None:
    assert limit(ZERO, Twist(9.0, -9.0), 0.1, LIMITS) == Twist(0.05, -0.4)
    assert limit(Twist(0.5, 0.0), ZERO, 0.1, LIMITS) == Twist(0.45, 0.0)
    assert limit(Twist(0.01, 0.0), ZERO, 0.1, LIMITS) == ZERO


def test_a_target_that_is_just_near_enough_is_reached_exactly() -> None:
    limits = replace(LIMITS, linear_accel_mps2=abs(0.05 - -0.57))
    assert -0.57 + limits.linear_accel_mps2 != 0.05
    assert limit(Twist(-0.57, 0.0), Twist(0.05, 0.0), 1.0, limits).linear == 0.05
    assert limit(Twist(0.57, 0.0), Twist(-0.05, 0.0), 1.0, limits).linear == -0.05


@pytest.mark.parametrize(("value", "clamped"), [(0.5, 0.2), (-0.5, -0.2), (0.2, 0.2), (-0.1, -0.1)])
def test_a_value_beyond_a_bound_becomes_the_bound_on_its_side(value: float, clamped: float) -> None:
    assert clamp(value, 0.2) == clamped


@pytest.mark.parametrize("command", [Twist(1.1, 0.0), Twist(0.0, -2.1), Twist(nan, 0.0)])
def test_a_command_beyond_the_limits_is_told(command: Twist) -> None:
    assert not within(command, LIMITS)
    assert within(Twist(1.0, -2.0), LIMITS)


def test_a_kernel_goes_on_from_a_state_of_other_limits() -> None:
    state = moving(ticks=30).state
    limits = VelocityLimits(0.1, 0.2, 0.5, 4.0)
    assert not within(state.command, limits)
    kernel = Kernel(replace(KernelParams(), limits=limits), state)
    assert kernel.state.command.linear == 0.1
    assert Kernel(KernelParams(), state).state == state


def test_a_late_tick_changes_the_command_by_no_more_than_two_periods_allow() -> None:
    bench = moving(ticks=5)
    before = bench.state.command
    bench.t_ns += 200_000_000
    bench.give(Tick(bench.t_ns))
    params = KernelParams()
    most = params.limits.linear_accel_mps2 * 2.0 / params.rate_hz
    assert 0.0 < bench.state.command.linear - before.linear <= most + 1e-12


def test_a_steady_clock_that_goes_back_is_a_tick_overrun() -> None:
    bench = moving()
    bench.give(Tick(bench.t_ns - 400_000_000))
    assert bench.state.cause is Cause.TICK_OVERRUN
    assert "went back by 0.40 s" in bench.state.reason
