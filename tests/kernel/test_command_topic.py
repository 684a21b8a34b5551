"""Other nodes on the velocity command: foreign publishers, and missing subscriptions."""

from __future__ import annotations

import pytest

from robotctl.kernel.command_types import TWIST, TWIST_STAMPED
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import CommandParams, KernelParams, Stamping
from robotctl.kernel.types import Cause, CommandListenersSeen, ForeignCommandHeard
from robotctl.testing.kernels import moving, ready, reset, start, stopped_by


def test_one_foreign_command_stops_a_moving_robot_in_the_same_step() -> None:
    bench = moving()
    bench.give(ForeignCommandHeard(bench.t_ns, "/teleop"))
    assert stopped_by(bench, Cause.FOREIGN_PUBLISHER, Mode.ERROR)
    assert "/teleop also published a velocity command" in bench.state.reason
    assert not reset(bench)
    bench.run(51)  # 1.02 s
    assert reset(bench)


def test_a_foreign_command_to_an_idle_robot_refuses_the_start_for_a_second_and_no_more() -> None:
    bench = ready()
    bench.give(ForeignCommandHeard(bench.t_ns, "/teleop"))
    assert bench.state.mode is Mode.IDLE
    assert "/teleop also published a velocity command" in start(bench)
    bench.run(51)
    assert not start(bench)


def test_no_start_where_no_node_takes_the_command() -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 0, ()))
    assert "no node subscribes to cmd_vel" in start(bench)
    bench.give(CommandListenersSeen(bench.t_ns, 1, ()))
    assert not start(bench)


def test_a_robot_that_wants_another_type_is_refused_with_that_type() -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 0, ("geometry_msgs/msg/TwistStamped",)))
    assert "takes geometry_msgs/msg/TwistStamped on cmd_vel" in start(bench)


@pytest.mark.parametrize(("ours", "other"), [(TWIST, TWIST_STAMPED), (TWIST_STAMPED, TWIST)])
def test_no_start_where_both_types_are_taken_and_none_is_configured(ours: str, other: str) -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 1, (other,), ours))
    assert f"some nodes take {TWIST} on cmd_vel, others {TWIST_STAMPED}" in start(bench)
    bench.give(CommandListenersSeen(bench.t_ns, 1, ("a/msg/A",), ours))
    assert not start(bench)


@pytest.mark.parametrize("stamped", [Stamping.TRUE, Stamping.FALSE])
def test_a_configured_type_is_sent_also_where_both_are_taken(stamped: Stamping) -> None:
    bench = ready(KernelParams(command=CommandParams(stamped=stamped)))
    bench.give(CommandListenersSeen(bench.t_ns, 1, (TWIST_STAMPED,)))
    assert not start(bench)


def test_the_type_that_robotctl_sends_is_named() -> None:
    bench = ready()
    bench.give(CommandListenersSeen(bench.t_ns, 0, (TWIST,), TWIST_STAMPED))
    assert f"takes {TWIST} on cmd_vel, not {TWIST_STAMPED}" in start(bench)


def test_listeners_that_leave_do_not_stop_a_moving_robot_by_themselves() -> None:
    bench = moving()
    bench.give(CommandListenersSeen(bench.t_ns, 0, ()))
    assert bench.state.mode is Mode.MOVING
