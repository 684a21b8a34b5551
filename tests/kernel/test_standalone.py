"""Without a robot, `standalone` lets the mode be MOVING; the robot that joins stands."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotctl.kernel.geometry import ORIGIN
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    Cause,
    CommandListenersSeen,
    CommandPublishersSeen,
    Event,
    FaultReported,
    ForeignCommandHeard,
    ModeChanged,
    ModeRequested,
    Odometry,
    OdomReceived,
    PublishTwist,
    Reply,
)
from robotctl.testing.kernels import Bench, in_mode, stopped_by


def alone() -> Bench:
    """A standalone kernel without a robot."""
    bench = Bench(KernelParams(standalone=True))
    bench.give(CommandListenersSeen(bench.t_ns, 0, ()))
    bench.tick()
    return bench


def asked(bench: Bench, mode: Mode) -> Reply:
    """The reply to a request for a mode; that for IDLE comes with the next tick."""
    before = len(bench.effects)
    bench.give(ModeRequested(bench.t_ns, 7, mode.value, "a test"))
    bench.tick()
    (reply,) = (effect for effect in bench.effects[before:] if isinstance(effect, Reply))
    return reply


def commands(bench: Bench) -> set[object]:
    """Every command so far."""
    return {effect.twist for effect in bench.effects if isinstance(effect, PublishTwist)}


def test_every_mode_is_answered_without_a_robot() -> None:
    bench = alone()
    answers = [asked(bench, mode) for mode in (Mode.MOVING, Mode.MOVING, Mode.IDLE, Mode.MOVING)]
    assert [(answer.ok, answer.message, answer.mode) for answer in answers] == [
        (True, "Mode changed to MOVING", Mode.MOVING),
        (True, "Mode is already MOVING", Mode.MOVING),
        (True, "Mode changed to IDLE", Mode.IDLE),
        (True, "Mode changed to MOVING", Mode.MOVING),
    ]
    assert asked(bench, Mode.EMERGENCY_STOP).mode is Mode.EMERGENCY_STOP
    assert not asked(bench, Mode.MOVING).ok
    assert asked(bench, Mode.IDLE).ok
    assert commands(bench) == {ZERO}


def test_without_standalone_no_robot_is_a_refusal() -> None:
    bench = Bench()
    bench.give(CommandListenersSeen(bench.t_ns, 0, ()))
    bench.tick()
    assert not asked(bench, Mode.MOVING).ok


def test_nothing_is_driven_without_a_robot() -> None:
    bench = alone()
    bench.drive()
    assert bench.replies[-1].message == "there is no robot to drive"
    assert asked(bench, Mode.MOVING).ok
    bench.drive(replacing=True)
    assert bench.replies[-1].message == "there is no robot to drive"
    assert bench.state.drive is None


JOINING = (
    OdomReceived(0, Odometry(ORIGIN, ZERO, 0)),
    CommandListenersSeen(0, 1, ()),
    CommandPublishersSeen(0, ("/gate",)),
    ForeignCommandHeard(0, "/gate"),
)


@pytest.mark.parametrize("event", JOINING, ids=lambda event: type(event).__name__)
def test_a_robot_that_joins_while_moving_stands_in_idle(event: Event) -> None:
    bench = alone()
    asked(bench, Mode.MOVING)
    before = len(bench.effects)
    bench.give(replace(event, t_ns=bench.t_ns))
    changes = [each for each in bench.effects[before:] if isinstance(each, ModeChanged)]
    assert [(each.mode, each.cause) for each in changes] == [(Mode.IDLE, None)]
    assert bench.effects[before] == PublishTwist(ZERO)
    answer = asked(bench, Mode.MOVING)
    assert not answer.ok, "its battery, its odometry or its gate is still missing"


def test_a_robot_that_is_complete_is_driven_as_any_other() -> None:
    bench = alone()
    bench.give(CommandListenersSeen(bench.t_ns, 1, ()))
    bench.odometry()
    bench.give(BatteryReceived(bench.t_ns, 1.0))
    assert asked(bench, Mode.MOVING).ok
    assert bench.state.drive is not None
    bench.t_ns += 600_000_000
    bench.give(OdomReceived(bench.t_ns - 600_000_000, Odometry(bench.state.drive.origin, ZERO, 1)))
    bench.tick()
    assert bench.state.mode is Mode.ERROR, "its odometry is checked"


@pytest.mark.parametrize("cause", [Cause.TASK_DIED, Cause.RECORDER_FAILED])
def test_what_the_daemon_reports_stops_it_without_a_robot_too(cause: Cause) -> None:
    bench = alone()
    asked(bench, Mode.MOVING)
    bench.give(FaultReported(bench.t_ns, cause, "it broke"))
    assert stopped_by(bench, cause, Mode.ERROR)


def test_a_gate_that_is_lost_ends_a_motion_and_refuses_the_next() -> None:
    bench = in_mode(Mode.MOVING)
    bench.give(FaultReported(bench.t_ns, Cause.GATE_LOST, "no gate"))
    assert stopped_by(bench, Cause.GATE_LOST, Mode.ERROR)
    bench = in_mode(Mode.IDLE)
    assert bench.give(FaultReported(bench.t_ns, Cause.GATE_LOST, "no gate")) == ()
    assert asked(bench, Mode.MOVING).message == "no gate"
