"""Each cause: when it stops the robot, when it only refuses the start, when it has cleared.

Safety inputs: what each reading does in each mode, and what silence does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf, nan

import pytest

from robotctl.kernel.checks import estop_silent, is_any_required
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import BatteryParams, KernelParams
from robotctl.kernel.safety import RULE_OF, RULES
from robotctl.kernel.safety_inputs import Reading, SafetyInput, SafetyInputParams, Use, with_reading
from robotctl.kernel.state import Health
from robotctl.kernel.types import (
    ZERO,
    Cause,
    CommandPublishersSeen,
    FaultCleared,
    FaultReported,
    ModeChanged,
    PublishTwist,
    SafetyInputReceived,
    Tick,
)
from robotctl.testing.kernels import Bench, in_mode, moving, ready, reset, start, stopped_by
from tests.support.cases import for_each

DAEMON_CAUSES = (Cause.TASK_DIED, Cause.RECORDER_FAILED, Cause.UNREACHABLE)


def test_every_cause_has_one_rule_and_a_cure() -> None:
    assert {rule.cause for rule in RULES} == set(Cause) == set(RULE_OF)
    assert len(RULES) == len(Cause)


def test_latching_causes_come_before_the_others() -> None:
    actions = [rule.action for rule in RULES]
    assert actions == sorted(actions, reverse=True)


# Battery


def with_battery(level: float) -> Bench:
    bench = ready()
    bench.battery(level)
    return bench


@for_each(("level", "stops"), [(0.16, False), (0.15, True), (0.1, True), (0.0, True)])
def test_a_low_battery_latches_while_moving(level: float, stops: bool) -> None:
    bench = moving()
    bench.battery(level)
    assert stopped_by(bench, Cause.BATTERY_LOW, Mode.EMERGENCY_STOP) is stops


@for_each("level", [0.15, 0.1, nan, inf, -inf, -1.0, 87.0, 1.06])
def test_a_low_or_unknown_battery_refuses_the_start_and_no_more(level: float) -> None:
    bench = with_battery(level)
    bench.tick()
    assert bench.state.mode is Mode.IDLE
    assert "battery" in start(bench)


@for_each("level", [nan, inf, -1.0, 87.0])
def test_an_unknown_battery_stops_a_moving_robot(level: float) -> None:
    bench = moving()
    bench.battery(level)
    assert stopped_by(bench, Cause.BATTERY_UNKNOWN, Mode.ERROR)


def test_a_robot_without_a_battery_is_not_asked_for_one() -> None:
    params = replace(KernelParams(), battery=BatteryParams(topic=""))
    bench = Bench(params)
    bench.tick()
    bench.odometry()
    bench.battery(0.01)
    assert not start(bench)


# Time


@for_each("first", [Bench.tick, Bench.odometry, lambda bench: bench.battery(1.0)])
def test_a_gap_between_ticks_is_the_cause_and_not_the_stale_odometry_it_leaves(
    first: Callable[[Bench], object],
) -> None:
    bench = moving()
    bench.t_ns += 1_500_000_000
    first(bench)
    assert stopped_by(bench, Cause.TICK_OVERRUN, Mode.ERROR)


def test_a_late_tick_has_not_cleared_while_ticks_are_late() -> None:
    bench = moving()
    for _ in range(2):
        bench.t_ns += 400_000_000
        bench.tick()
        bench.odometry()
    assert stopped_by(bench, Cause.TICK_OVERRUN, Mode.ERROR)
    bench.t_ns += 400_000_000
    bench.odometry()
    assert not reset(bench)
    assert "no control tick for 0.40 s" in bench.replies[-1].message
    bench.run(2)
    assert reset(bench)


def test_no_start_in_a_gap_between_ticks() -> None:
    bench = ready()
    bench.t_ns += 400_000_000  # the odometry is fresh still
    assert "no control tick for 0.40 s" in start(bench)
    bench.run(2)
    assert not start(bench)


@for_each("jump_ns", [-(10**18), -1_000_000_000, 10**18])
def test_steady_time_that_jumps_stops_a_moving_robot_and_no_more(jump_ns: int) -> None:
    bench = moving()
    effects = bench.give(Tick(bench.t_ns + jump_ns))
    assert bench.state.mode is Mode.ERROR
    assert effects[0] == PublishTwist(ZERO)


@for_each("begin_ns", [0, 86_400_000_000_000, 2**53, 2**62])
def test_a_drive_is_the_same_at_any_steady_time(begin_ns: int) -> None:
    commands = []
    for offset_ns in (0, begin_ns):
        bench = Bench()
        bench.t_ns += offset_ns
        bench.run(3)
        bench.request(Mode.MOVING)
        bench.run(30)
        commands.append(bench.commands)
    assert commands[0] == commands[1]


# The daemon


@for_each("mode", [Mode.IDLE, Mode.MOVING])
@for_each("cause", DAEMON_CAUSES)
@for_each("detail", ["it broke", ""])
def test_a_failing_daemon_stops_the_robot_in_the_same_step(
    mode: Mode, cause: Cause, detail: str
) -> None:
    bench = in_mode(mode)
    effects = bench.give(FaultReported(bench.t_ns, cause, detail))
    assert stopped_by(bench, cause, Mode.ERROR)
    assert effects[0] == PublishTwist(ZERO)
    assert detail in bench.state.reason
    assert not reset(bench)
    bench.give(FaultCleared(bench.t_ns, cause))
    assert reset(bench)


def test_a_fault_that_is_reported_again_is_one_fault_and_its_last_words_count() -> None:
    bench = ready()
    for number in range(100):
        bench.give(FaultReported(bench.t_ns, Cause.TASK_DIED, f"death {number}"))
    assert bench.state.health.reported == ((Cause.TASK_DIED, "death 99"),)


def test_a_daemon_that_ends_lets_a_motion_ramp_down() -> None:
    bench = moving()
    bench.give(FaultReported(bench.t_ns, Cause.DAEMON_ENDS, "told to stop"))
    assert bench.state.mode is Mode.MOVING
    bench.drive(replacing=True)
    assert "told to stop" in bench.replies[-1].message


def test_commands_of_a_node_without_a_name_stop_the_robot() -> None:
    bench = moving()
    bench.give(CommandPublishersSeen(bench.t_ns, ("",)))
    assert stopped_by(bench, Cause.FOREIGN_PUBLISHER, Mode.ERROR)


def test_a_stop_is_said_once() -> None:
    bench = moving()
    bench.battery(0.1)
    bench.battery(0.1)
    bench.run(3)
    changes = [effect for effect in bench.effects if isinstance(effect, ModeChanged)]
    assert [change.mode for change in changes] == [Mode.MOVING, Mode.EMERGENCY_STOP]


STOPPED_BY = {
    SafetyInput.ESTOP: (Cause.ESTOP_PRESSED, Mode.EMERGENCY_STOP, (1.0, -1.0, nan), (0.0,)),
    SafetyInput.JOY: (Cause.ESTOP_PRESSED, Mode.EMERGENCY_STOP, (1.0, -1.0, nan), (0.0,)),
    SafetyInput.BUMPER: (Cause.BUMPER_PRESSED, Mode.ERROR, (1.0, -1.0, nan), (0.0,)),
    SafetyInput.TILT: (Cause.TILTED, Mode.ERROR, (0.36, 3.0, inf, nan), (0.0, 0.35)),
    SafetyInput.DIAGNOSTICS: (Cause.BASE_FAULT, Mode.ERROR, (2.0, 3.0, nan), (0.0, 1.0)),
}
STOPS = [(kind, value) for kind, row in STOPPED_BY.items() for value in row[2]]
PASSES = [(kind, value) for kind, row in STOPPED_BY.items() for value in row[3]]
TIMEOUT_S = 0.3
LATCHING = (SafetyInput.ESTOP, SafetyInput.JOY)


def params(kind: SafetyInput, use: Use) -> KernelParams:
    inputs = SafetyInputParams()
    changed = {kind.value: replace(inputs.of(kind), use=use, timeout_s=TIMEOUT_S)}
    return replace(KernelParams(), inputs=replace(inputs, **changed))  # type: ignore[arg-type]


def read(bench: Bench, kind: SafetyInput, value: float, detail: str = "") -> None:
    bench.give(SafetyInputReceived(bench.t_ns, kind, value, detail))


def driving(kind: SafetyInput, use: Use) -> Bench:
    """Return a bench that moves, with the input heard once."""
    bench = ready(params(kind, use))
    read(bench, kind, 0.0)
    assert not start(bench)
    return bench


@for_each("use", [Use.OPTIONAL, Use.REQUIRED])
@for_each(("kind", "value"), STOPS)
def test_a_reading_that_says_stop_stops_in_the_same_step(
    kind: SafetyInput, value: float, use: Use
) -> None:
    bench = driving(kind, use)
    read(bench, kind, value)
    cause, mode, _, _ = STOPPED_BY[kind]
    assert stopped_by(bench, cause, mode)
    assert not reset(bench)
    read(bench, kind, 0.0)
    assert reset(bench)


@for_each(("kind", "value"), PASSES)
def test_other_readings_stop_nothing(kind: SafetyInput, value: float) -> None:
    bench = driving(kind, Use.REQUIRED)
    read(bench, kind, value)
    assert bench.state.mode is Mode.MOVING


@for_each(("kind", "value"), STOPS)
def test_an_input_that_is_off_is_ignored(kind: SafetyInput, value: float) -> None:
    bench = moving()
    read(bench, kind, value)
    assert bench.state.mode is Mode.MOVING


@for_each(("kind", "value"), STOPS)
def test_an_idle_robot_is_latched_by_a_button_and_refused_by_the_others(
    kind: SafetyInput, value: float
) -> None:
    bench = ready(params(kind, Use.OPTIONAL))
    read(bench, kind, value)
    assert (bench.state.mode is Mode.EMERGENCY_STOP) is (kind in LATCHING)
    assert start(bench)


@for_each("kind", SafetyInput)
def test_a_required_input_that_is_silent_stops_and_an_optional_one_does_not(
    kind: SafetyInput,
) -> None:
    for use in (Use.REQUIRED, Use.OPTIONAL):
        bench = driving(kind, use)
        bench.run(round(TIMEOUT_S * 50))
        assert bench.state.mode is Mode.MOVING
        bench.run(1)
        if use is Use.OPTIONAL:
            assert bench.state.mode is Mode.MOVING
        elif kind in LATCHING:
            assert stopped_by(bench, Cause.ESTOP_SILENT, Mode.EMERGENCY_STOP)
        else:
            assert stopped_by(bench, Cause.INPUT_LOST, Mode.ERROR)


@for_each("kind", SafetyInput)
def test_a_required_input_that_was_never_heard_refuses_the_start_and_no_more(
    kind: SafetyInput,
) -> None:
    bench = ready(params(kind, Use.REQUIRED))
    assert bench.state.mode is Mode.IDLE
    topic = bench.kernel.params.inputs.of(kind).topic
    assert f"nothing was received on {topic} yet" in start(bench)
    read(bench, kind, 0.0)
    assert not start(bench)


@for_each("use", Use)
@for_each("kind", SafetyInput)
def test_one_required_input_is_enough_for_the_rules_about_silence(
    kind: SafetyInput, use: Use
) -> None:
    assert is_any_required(params(kind, use)) is (use is Use.REQUIRED)


def test_readings_of_other_inputs_than_there_are_now_are_not_taken_for_these() -> None:
    with pytest.raises(ValueError, match="shorter"):
        with_reading((None,), Reading(SafetyInput.ESTOP, 0.0, 1))


def test_a_reading_of_the_future_is_as_old_as_one_of_the_past() -> None:
    health = Health(inputs=with_reading((), Reading(SafetyInput.ESTOP, 0.0, 10**12)))
    assert "for 1000.00 s" in estop_silent(health, params(SafetyInput.ESTOP, Use.REQUIRED), 0)


@for_each(
    ("kind", "value", "detail", "reason"),
    [
        (SafetyInput.ESTOP, 1.0, "", "the emergency stop on estop_pressed is pressed"),
        (SafetyInput.ESTOP, nan, "", "the emergency stop on estop_pressed cannot be read"),
        (SafetyInput.JOY, 1.0, "", "the emergency stop on joy is pressed"),
        (SafetyInput.BUMPER, 1.0, "", "the bumper on bumper is pressed"),
        (SafetyInput.BUMPER, nan, "", "the bumper on bumper cannot be read"),
        (SafetyInput.TILT, 0.5, "", "the robot is tilted by 0.50 rad, more than 0.35 rad"),
        (SafetyInput.TILT, nan, "", "imu holds no orientation"),
        (SafetyInput.DIAGNOSTICS, 2.0, "too hot", "diagnostics report an error: too hot"),
        (SafetyInput.DIAGNOSTICS, 2.0, "", "diagnostics report an error: without a text"),
    ],
)
def test_the_reason_says_what_the_input_told(
    kind: SafetyInput, value: float, detail: str, reason: str
) -> None:
    bench = driving(kind, Use.OPTIONAL)
    read(bench, kind, value, detail)
    assert bench.state.reason == reason
