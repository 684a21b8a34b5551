"""The lifecycle of the node that gates motion is a start condition."""

from __future__ import annotations

import pytest

from robotctl.ipc.advice import cure_of
from robotctl.kernel.modes import Mode
from robotctl.kernel.types.events import LifecycleChanged, LifecycleState
from robotctl.testing.kernels import moving, ready, start

STOPPED = [state for state in LifecycleState if state is not LifecycleState.ACTIVE]


@pytest.mark.parametrize("state", STOPPED)
def test_motion_starts_only_while_the_node_is_active(state: LifecycleState) -> None:
    bench = ready()
    bench.give(LifecycleChanged(bench.t_ns, state, "a test"))
    bench.run(3)
    assert start(bench) == f"mode_service is {state.value}, not active"
    (remedy,) = bench.replies[-1].remedies
    assert "change_state '{transition: {label: activate}}' --robot r2" in cure_of(remedy, "r2")
    bench.give(LifecycleChanged(bench.t_ns, LifecycleState.ACTIVE, "a test"))
    assert start(bench) == ""


@pytest.mark.parametrize("state", STOPPED)
def test_a_node_that_is_not_active_does_not_stop_by_itself(state: LifecycleState) -> None:
    """The daemon requests IDLE: the robot ramps down, and does not end in ERROR."""
    bench = moving()
    effects = bench.give(LifecycleChanged(bench.t_ns, state, "a test"))
    bench.run(3)
    assert effects == ()
    assert bench.state.mode is Mode.MOVING
