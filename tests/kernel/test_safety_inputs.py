"""Safety inputs: what each reading does in each mode, and what silence does."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from robotctl.kernel.input_checks import estop_silent, is_any_required
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.safety_inputs import Reading, SafetyInput, SafetyInputParams, Use, with_reading
from robotctl.kernel.state import Health
from robotctl.kernel.types import Cause, SafetyInputReceived
from robotctl.testing.kernels import Bench, moving, ready, reset, start, stopped_by

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


@pytest.mark.parametrize("use", [Use.OPTIONAL, Use.REQUIRED])
@pytest.mark.parametrize(("kind", "value"), STOPS)
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


@pytest.mark.parametrize(("kind", "value"), PASSES)
def test_other_readings_stop_nothing(kind: SafetyInput, value: float) -> None:
    bench = driving(kind, Use.REQUIRED)
    read(bench, kind, value)
    assert bench.state.mode is Mode.MOVING


@pytest.mark.parametrize(("kind", "value"), STOPS)
def test_an_input_that_is_off_is_ignored(kind: SafetyInput, value: float) -> None:
    bench = moving()
    read(bench, kind, value)
    assert bench.state.mode is Mode.MOVING


@pytest.mark.parametrize(("kind", "value"), STOPS)
def test_an_idle_robot_is_latched_by_a_button_and_refused_by_the_others(
    kind: SafetyInput, value: float
) -> None:
    bench = ready(params(kind, Use.OPTIONAL))
    read(bench, kind, value)
    assert (bench.state.mode is Mode.EMERGENCY_STOP) is (kind in LATCHING)
    assert start(bench)


@pytest.mark.parametrize("kind", SafetyInput)
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


@pytest.mark.parametrize("kind", SafetyInput)
def test_a_required_input_that_was_never_heard_refuses_the_start_and_no_more(
    kind: SafetyInput,
) -> None:
    bench = ready(params(kind, Use.REQUIRED))
    assert bench.state.mode is Mode.IDLE
    topic = bench.kernel.params.inputs.of(kind).topic
    assert f"nothing was received on {topic} yet" in start(bench)
    read(bench, kind, 0.0)
    assert not start(bench)


@pytest.mark.parametrize("use", Use)
@pytest.mark.parametrize("kind", SafetyInput)
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


@pytest.mark.parametrize(
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
