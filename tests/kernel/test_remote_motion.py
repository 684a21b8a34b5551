"""Another host starts no motion unless it is allowed to; it stops the robot always."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.types import DriveRequested, ModeRequested
from robotctl.testing.kernels import Bench, moving, ready

REMOTE_MOTION = KernelParams(remote_motion=True)


def move(bench: Bench, *, remote: bool) -> None:
    event = ModeRequested(bench.t_ns, 1, Mode.MOVING, "the ROS service", remote=remote)
    bench.give(event)


def drive(bench: Bench, *, remote: bool) -> None:
    event = DriveRequested(bench.t_ns, 1, Pattern(), 1, False, "the ROS service", remote=remote)
    bench.give(event)


@pytest.mark.parametrize("ask", [move, drive])
def test_a_motion_that_another_host_asks_for_is_refused_and_the_robot_stands(
    ask: Callable[..., None],
) -> None:
    bench = ready()
    ask(bench, remote=True)
    (reply,) = bench.replies
    assert not reply.ok
    assert reply.message == "the ROS service was called from another host, or may have been"
    assert reply.remedies == (Remedy.ASK_HERE,)
    bench.run(5)
    assert bench.state.mode is Mode.IDLE


@pytest.mark.parametrize("ask", [move, drive])
@pytest.mark.parametrize(("remote", "params"), [(True, REMOTE_MOTION), (False, KernelParams())])
def test_a_motion_is_granted_to_this_host_and_to_another_one_where_that_is_configured(
    ask: Callable[..., None], remote: bool, params: KernelParams
) -> None:
    bench = ready(params)
    ask(bench, remote=remote)
    assert bench.replies[-1].ok
    assert bench.state.mode is Mode.MOVING


@pytest.mark.parametrize("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
def test_another_host_stops_the_robot(mode: Mode) -> None:
    bench = moving()
    bench.give(ModeRequested(bench.t_ns, 7, mode, "the ROS service", remote=True))
    bench.run(100)
    assert bench.state.mode is mode
