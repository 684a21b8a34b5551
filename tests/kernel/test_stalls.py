"""After a short stall the drive continues from zero; a long stall stops the robot."""

from __future__ import annotations

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import (
    ZERO,
    Cause,
    LoopStalled,
    ModeChanged,
    Phase,
    PublishTwist,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.testing.kernels import Bench, in_mode, moving, reset, stopped_by

LIMIT_S = KernelParams().max_tick_gap_s


def stall(bench: Bench, seconds: float) -> None:
    """Stall the loop; the watchdog reports it before any other event."""
    bench.t_ns += round(seconds * NS_PER_S)
    bench.give(LoopStalled(bench.t_ns, seconds, 3, 1, "in read_text (pathlib.py:1058)"))


def test_after_a_short_stall_the_command_ramps_up_from_zero() -> None:
    bench = moving(ticks=40)
    before = bench.state.command
    assert before.linear > 0.3
    stall(bench, 0.25)
    assert bench.state.mode is Mode.MOVING
    assert bench.state.command == ZERO
    bench.commands.clear()
    limits = KernelParams().limits
    speed = 0.0
    for _ in range(10):
        bench.odometry(bench.state.drive.reference().pose)  # type: ignore[union-attr]
        (effect,) = bench.tick()
        assert isinstance(effect, PublishTwist)
        assert 0.0 <= effect.twist.linear - speed <= limits.linear_accel_mps2 * 0.02 + 1e-9
        speed = effect.twist.linear
    assert speed > 0.05


@pytest.mark.parametrize("seconds", [LIMIT_S + 0.01, 3.0, float("nan")])
def test_a_stall_beyond_the_tick_gap_stops_a_moving_robot_and_names_the_culprit(
    seconds: float,
) -> None:
    bench = moving()
    bench.give(LoopStalled(bench.t_ns, seconds, 3, 1, "in read_text (pathlib.py:1058)"))
    assert stopped_by(bench, Cause.LOOP_STALLED, Mode.ERROR)
    assert "in read_text (pathlib.py:1058)" in bench.state.reason
    assert reset(bench)  # it is over


def test_a_stall_as_long_as_the_tick_gap_is_still_short() -> None:
    bench = moving()
    stall(bench, LIMIT_S)
    assert bench.state.mode is Mode.MOVING


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
@pytest.mark.parametrize("seconds", [0.2, 3.0])
def test_a_stall_of_a_robot_that_stands_is_counted_and_no_more(mode: Mode, seconds: float) -> None:
    bench = in_mode(mode)
    bench.effects.clear()
    for count in (1, 2):
        stall(bench, seconds)
        assert bench.state.health.stalls.count == count
    stalls = bench.state.health.stalls
    assert (stalls.last_t_ns, stalls.last_s) == (bench.t_ns, seconds)
    assert bench.state.mode is mode
    assert not any(isinstance(effect, ModeChanged) for effect in bench.effects)


def test_a_ramp_down_that_stalls_has_ended() -> None:
    bench = moving(ticks=40)
    bench.request(Mode.IDLE)
    assert bench.state.phase is Phase.STOPPING
    stall(bench, 0.2)
    bench.tick()
    assert bench.state.mode is Mode.IDLE
    assert bench.replies[-1].ok
