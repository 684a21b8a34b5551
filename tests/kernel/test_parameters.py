"""The numbers and topics of the kernel are those of docs/ros.md: default, limits and unit.

A parameter changes by an event: while the robot stands, within its limits, with one reply.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.parameter_keys import Conflict, conflict, kernel_leaves, value_at
from robotctl.kernel.params import (
    BatteryParams,
    BatteryScale,
    CommandParams,
    Foreign,
    KernelParams,
    ScanParams,
    WhenIdle,
)
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.safety_inputs import SafetyInput, Use
from robotctl.kernel.types import Cause, Effect, ParameterChanged, ParameterRequested, Remedy, Reply
from robotctl.testing.kernels import Bench, in_mode, moving, ready, start, stopped_by
from tests.support.cases import for_each

PAGE = (Path(__file__).parents[2] / "docs" / "ros.md").read_text()
DOCUMENTED = dict(re.findall(r"^\| `([\w.]+)` \| (\S* \| [^|]*?) \|", PAGE, re.MULTILINE))


def parameters(values: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the key of each number, topic and frame, and the row that the page must have for it."""
    for field in fields(values):
        value = getattr(values, field.name)
        if is_dataclass(value):
            yield from parameters(value, f"{prefix}{field.name}.")
        elif "range" in field.metadata:
            allowed = field.metadata["range"]
            said = f"{value} | {allowed.low:g} to {allowed.high:g} {allowed.unit}".rstrip()
            yield f"{prefix}{field.name}", said
        elif field.metadata.get("topic"):
            none = '; "" for none' if field.metadata["optional"] else ""
            yield f"{prefix}{field.name}", f"{value} | a topic{none}"
        elif field.metadata.get("frame"):
            none = '; "" for any' if field.metadata["optional"] else ""
            yield f"{prefix}{field.name}", f"{value} | the name of a frame{none}"


PARAMETERS = dict(parameters(KernelParams()))


@for_each("key", PARAMETERS)
def test_a_parameter_is_as_the_page_says(key: str) -> None:
    assert DOCUMENTED[key] == PARAMETERS[key]


def test_every_parameter_is_on_the_page_or_is_a_choice_or_corners() -> None:
    assert {"rate_hz", "command.topic", "inputs.joy.button", "tracking.k_y"} <= set(PARAMETERS)
    params = KernelParams()
    others = {key: leaf for key, leaf in kernel_leaves().items() if key not in PARAMETERS}
    del others["fence.corners_m"]
    for key, leaf in others.items():
        assert isinstance(value_at(params, leaf.path), (Enum, bool)), key


@for_each(
    ("pattern", "is_allowed"),
    [
        (Pattern(size_m=0.1), True),
        (Pattern(size_m=100.0), True),
        (Pattern(speed_mps=0.01), True),
        (Pattern(speed_mps=10.0), True),
        (Pattern(size_m=0.099), False),
        (Pattern(size_m=100.1), False),
        (Pattern(speed_mps=0.0099), False),
        (Pattern(speed_mps=10.1), False),
        (Pattern(size_m=float("nan")), False),
        (Pattern(speed_mps=float("nan")), False),
    ],
)
def test_a_pattern_is_refused_beyond_its_limits(pattern: Pattern, is_allowed: bool) -> None:
    assert (pattern.refusal() == "") is is_allowed


def change(bench: Bench, key: str, old: str, new: str) -> tuple[Effect, ...]:
    request_id = bench.new_request_id()
    return bench.give(ParameterRequested(bench.t_ns, request_id, key, old, new, "test"))


def reply_of(effects: tuple[Effect, ...]) -> Reply:
    """Return the reply, which is the last effect and the only reply."""
    (reply,) = (effect for effect in effects if isinstance(effect, Reply))
    assert effects[-1] is reply
    return reply


def kind_of(bench: Bench) -> PatternKind:
    """Return the pattern of the present drive."""
    assert bench.state.drive is not None
    return bench.state.drive.pattern.kind


@for_each("mode", [Mode.IDLE, Mode.ERROR, Mode.EMERGENCY_STOP])
def test_a_limit_changes_in_every_mode_but_moving(mode: Mode) -> None:
    bench = in_mode(mode)
    changed, reply = change(bench, "limits.linear_mps", "0.6", "0.4")
    assert changed == ParameterChanged("limits.linear_mps", "0.6", "0.4", "test")
    assert reply == Reply(reply_of((reply,)).request_id, True, "limits.linear_mps is 0.4", mode)
    assert bench.kernel.params.limits.linear_mps == 0.4


def test_the_next_drive_keeps_to_a_new_limit() -> None:
    bench = ready()
    change(bench, "limits.linear_mps", "0.6", "0.1")
    bench.request(Mode.MOVING)
    bench.run(100)
    assert max(command.linear for command in bench.commands) == pytest.approx(0.09, abs=0.011)


def test_a_limit_does_not_change_while_the_robot_moves() -> None:
    bench = moving()
    reply = reply_of(change(bench, "limits.linear_mps", "0.6", "0.1"))
    assert (reply.ok, reply.remedies) == (False, (Remedy.STOP_FIRST,))
    assert reply.message == "limits.linear_mps does not change while the robot is MOVING"
    assert bench.kernel.params == KernelParams()
    bench.run(10)
    assert bench.state.mode is Mode.MOVING


def test_the_pattern_of_the_next_drive_changes_while_the_robot_moves() -> None:
    bench = moving()
    assert reply_of(change(bench, "pattern.kind", "square", "circle")).ok
    assert kind_of(bench) is PatternKind.SQUARE
    bench.request(Mode.IDLE)
    bench.run(100)
    bench.request(Mode.MOVING)
    assert kind_of(bench) is PatternKind.CIRCLE


@for_each(
    ("key", "old", "new", "why"),
    [
        ("rate_hz", "50.0", "100.0", "rate_hz changes at a start only"),
        ("command.topic", "cmd_vel", "other", "command.topic changes at a start only"),
        ("limits.linear_mps", "0.5", "0.4", "limits.linear_mps is 0.6, not 0.5"),
        ("limits.linear_mps", "0.7", "0.4", "limits.linear_mps is 0.6, not 0.7"),
        ("limits.linear_mps", "0.6", "11.0", "11.0 is not from 0.01 to 10"),
        ("limits.linear_mps", "0.6", "nan", "nan is not from 0.01 to 10"),
        ("limits.linear_mps", "0.6", "fast", "could not convert"),
        ("pattern.kind", "square", "star", "'star' is not a valid PatternKind"),
        ("battery.stop_level", "0.15", "0.3", "use at least battery.stop_level, 0.3"),
        ("max_tick_gap_s", "0.3", "0.05", "at least two periods"),
    ],
)
def test_what_is_not_allowed_is_refused_and_changes_nothing(
    key: str, old: str, new: str, why: str
) -> None:
    bench = ready(replace(KernelParams(), rate_hz=39.0) if key == "max_tick_gap_s" else None)
    before = bench.kernel.params
    (reply,) = change(bench, key, old, new)
    assert isinstance(reply, Reply)
    assert not reply.ok
    assert why in reply.message
    assert bench.kernel.params is before


@for_each(
    ("key", "old", "new"),
    [
        ("limits.linear_mps", "0.6", "0.01"),
        ("limits.linear_mps", "0.6", "10.0"),
        ("battery.stop_level", "0.15", "0.2"),
        ("battery.clear_level", "0.2", "0.15"),
        ("max_tick_gap_s", "0.3", "0.05"),
    ],
)
def test_the_limits_of_a_parameter_are_allowed_themselves(key: str, old: str, new: str) -> None:
    bench = ready(replace(KernelParams(), rate_hz=40.0))
    changed, reply = change(bench, key, old, new)
    assert changed == ParameterChanged(key, old, new, "test")
    assert isinstance(reply, Reply)
    assert reply.ok


def test_the_same_value_is_granted_without_a_change() -> None:
    bench = ready()
    (reply,) = change(bench, "limits.linear_mps", "0.6", "0.6")
    assert isinstance(reply, Reply)
    assert reply.ok


def test_a_parameter_of_the_daemon_is_decided_too_but_not_kept() -> None:
    bench = ready()
    asked = ("on_recorder_failure", "stop", "warn")
    changed, _ = change(bench, *asked)
    assert changed == ParameterChanged(*asked, "test")
    assert bench.kernel.params == KernelParams()
    assert not reply_of(change(moving(), *asked)).ok


@for_each(
    ("first", "second"), [("command", "odometry"), ("command", "battery"), ("odometry", "battery")]
)
def test_two_parts_on_one_topic_are_a_conflict(first: str, second: str) -> None:
    params = KernelParams()
    topic = getattr(params, first).topic
    changed = replace(params, **{second: replace(getattr(params, second), topic=f"/{topic}")})
    found = conflict(changed)
    assert found is not None
    assert found.key == f"{second}.topic"


@for_each("kind", SafetyInput)
def test_an_input_on_the_topic_of_another_part_is_a_conflict_if_it_is_used(
    kind: SafetyInput,
) -> None:
    params = KernelParams()

    def found_for(use: Use) -> Conflict | None:
        one: Any = replace(params.inputs.of(kind), topic=params.odometry.topic, use=use)
        return conflict(replace(params, inputs=replace(params.inputs, **{kind.value: one})))

    found = found_for(Use.REQUIRED)
    assert found is not None
    assert found.key == f"inputs.{kind.value}.topic"
    assert found_for(Use.OFF) is None


SCANNED = ScanParams(use=Use.OPTIONAL, topic="odom")
LOCKED = CommandParams(lock_topic="/odom")


@for_each(
    ("params", "key"),
    [
        (KernelParams(scan=SCANNED), "scan.topic"),
        (KernelParams(scan=replace(SCANNED, use=Use.OFF)), None),
        (KernelParams(guard=True, guard_topic="odom"), "guard_topic"),
        (KernelParams(guard=False, guard_topic="odom"), None),
        (KernelParams(command=LOCKED), "command.lock_topic"),
    ],
)
def test_a_scan_a_guard_and_a_lock_have_a_topic_of_their_own_if_they_are_used(
    params: KernelParams, key: str | None
) -> None:
    found = conflict(params)
    assert (found and (found.key, found.allowed)) == (
        key and (key, "odometry.topic is the same topic, use another one")
    )


@for_each("when_idle", WhenIdle)
@for_each("foreign", Foreign)
def test_only_who_is_silent_in_idle_yields_to_others(foreign: Foreign, when_idle: WhenIdle) -> None:
    found = conflict(KernelParams(command=CommandParams(foreign=foreign, when_idle=when_idle)))
    is_refused = foreign is Foreign.YIELD and when_idle is not WhenIdle.SILENT
    assert (found is not None) is is_refused
    said = ("command.foreign", "use command.when_idle silent with it")
    assert found is None or (found.key, found.allowed) == said


def bench_of(scale: BatteryScale) -> Bench:
    return ready(replace(KernelParams(), battery=BatteryParams(scale=scale)))


def test_a_level_beyond_the_scale_is_refused_as_it_came_with_its_remedy() -> None:
    bench = bench_of(BatteryScale.ONE)
    bench.battery(87.4)
    assert "the battery reports 87.4, not 0 to 1" in start(bench)
    assert bench.replies[-1].remedies == (Remedy.CHECK_BATTERY_TOPIC,)


@for_each("scale", [BatteryScale.PERCENT, BatteryScale.AUTO])
def test_a_gauge_that_counts_in_percent_is_understood(scale: BatteryScale) -> None:
    bench = bench_of(scale)
    bench.battery(87.4)
    assert bench.state.health.battery_level == 87.4 / 100.0
    assert not start(bench)
    bench.battery(14.0)
    assert stopped_by(bench, Cause.BATTERY_LOW, Mode.EMERGENCY_STOP)


def test_auto_stays_with_percent_once_it_has_seen_it() -> None:
    bench = bench_of(BatteryScale.AUTO)
    bench.battery(87.4)
    bench.battery(1.0)
    assert bench.state.health.battery_level == 0.01


@for_each("broken", [float("inf"), float("nan"), 1e9, -5.0])
def test_one_broken_sample_does_not_change_the_scale(broken: float) -> None:
    bench = bench_of(BatteryScale.AUTO)
    bench.battery(broken)
    bench.battery(0.8)
    assert bench.state.health.battery_level == 0.8
