"""A shadow decides on the same events with other parameters, and is compared exactly."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import nan

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.parameter_change import ParameterRequested
from robotctl.kernel.params import BatteryParams, KernelParams, VelocityLimits
from robotctl.kernel.shadow import Aspect, Shadow, aspects_of, contrast, outcome
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    ZERO,
    Cause,
    DriveEnded,
    DriveReport,
    Effect,
    Event,
    LatchEmergencyStop,
    ModeChanged,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    Tick,
    Twist,
)
from robotctl.testing.kernels import Bench, ready
from tests.support import strategies

PARAMS = KernelParams()
SLOW = replace(PARAMS, limits=VelocityLimits(linear_mps=0.1))
SLOW_KEYS = ("limits.linear_mps",)


class Both(Bench):
    """A bench whose kernel has a shadow."""

    def __init__(self, shadow: KernelParams, own: Iterable[str] = ()) -> None:
        super().__init__(PARAMS)
        self.shadow = Shadow(shadow, self.state, tuple(own))
        self.otherwise: list[tuple[Effect, ...]] = []
        """What the shadow decided differently."""

    def give(self, event: Event) -> tuple[Effect, ...]:
        effects = super().give(event)
        mine = self.shadow.step(event, effects, self.state)
        if mine is not None:
            self.otherwise.append(mine)
        return effects

    def prepare(self) -> None:
        """Make the start conditions hold, as `ready` does."""
        self.odometry()
        self.battery(1.0)
        self.tick()


def moving_both(shadow: KernelParams, own: Iterable[str] = ()) -> Both:
    bench = Both(shadow, own)
    bench.prepare()
    bench.drive()
    return bench


def turn(bench: Both, ticks: int) -> None:
    """Let a robot follow the reference of the driving kernel exactly."""
    for _ in range(ticks):
        drive, last = bench.state.drive, bench.state.health.odometry
        assert last is not None
        bench.odometry(drive.reference().pose if drive is not None else last.pose)
        bench.tick()


@settings(max_examples=12, deadline=None, phases=[Phase.generate])
@given(st.data())
def test_a_shadow_with_the_same_parameters_never_differs(data: st.DataObject) -> None:
    bench = moving_both(PARAMS)
    numbers = st.integers(100, 10_000)
    for _ in range(8):
        now = st.integers(bench.t_ns - 10, bench.t_ns + 10)
        bench.give(data.draw(strategies.event(now, numbers)))
        bench.battery(1.0)
        bench.run(2)
    assert bench.otherwise == []
    assert bench.shadow.differing == 0
    assert bench.shadow.params == bench.kernel.params
    assert repr(bench.shadow.state) == repr(bench.state)


def test_a_slower_shadow_is_compared_until_the_robot_is_idle_again() -> None:
    bench = moving_both(SLOW, SLOW_KEYS)
    turn(bench, 20)
    first = bench.shadow.first
    assert first is not None
    assert first.aspects == (Aspect.COMMAND,)
    assert bench.otherwise[0] == (PublishTwist(Twist(0.1, 0.0)),)
    apart_since_ns = bench.shadow.apart_since_ns
    assert apart_since_ns == first.t_ns
    assert bench.shadow.differing == bench.shadow.by_aspect[Aspect.COMMAND] == len(bench.otherwise)
    bench.request(Mode.IDLE)
    turn(bench, 60)
    assert bench.state.mode.name == "IDLE"
    assert bench.shadow.state == bench.state
    assert bench.shadow.apart_since_ns is None
    assert bench.shadow.steps == len(bench.events)
    before = bench.shadow.differing
    turn(bench, 10)
    assert bench.shadow.differing == before
    assert bench.shadow.first is first
    assert bench.shadow.last is not None
    assert bench.shadow.last.t_ns > first.t_ns


def test_a_shadow_that_would_refuse_the_motion_is_told_by_its_answer() -> None:
    strict = replace(PARAMS, battery=BatteryParams(stop_level=0.5, clear_level=0.6))
    bench = Both(strict, ("battery.stop_level", "battery.clear_level"))
    bench.prepare()
    bench.battery(0.4)
    bench.drive()
    first = bench.shadow.first
    assert first is not None
    assert first.aspects == (Aspect.MODE, Aspect.ANSWER)
    assert bench.state.mode is Mode.MOVING
    assert bench.shadow.state.mode is Mode.IDLE
    (refused,) = first.shadow
    assert isinstance(refused, Reply)
    assert not refused.ok


def test_a_shadow_that_moves_alone_returns_to_the_state_of_the_idle_robot() -> None:
    lax = replace(PARAMS, battery=BatteryParams(stop_level=0.05, clear_level=0.1))
    bench = Both(lax, ("battery.stop_level", "battery.clear_level"))
    bench.prepare()
    bench.battery(0.12)
    bench.drive()
    assert len(bench.otherwise) == 1
    assert bench.shadow.state == bench.state
    turn(bench, 5)
    assert len(bench.otherwise) == 1


def change(bench: Both, key: str, old: str, new: str) -> None:
    bench.give(ParameterRequested(bench.t_ns, bench.new_request_id(), key, old, new, "test"))


def test_a_change_of_a_parameter_is_for_both_unless_it_is_the_shadows_own() -> None:
    bench = Both(SLOW, SLOW_KEYS)
    change(bench, "tracking.k_y", "20.0", "8.0")
    change(bench, "limits.linear_mps", "0.6", "0.4")
    change(bench, "on_recorder_failure", "stop", "warn")
    change(bench, "tracking.k_x", "1.0", "2.0")  # refused: it is not 1.0
    assert bench.kernel.params.limits.linear_mps == 0.4
    assert bench.shadow.params == replace(SLOW, tracking=replace(PARAMS.tracking, k_y=8.0))
    assert bench.shadow.differing == 0


def test_a_change_that_does_not_fit_the_shadows_own_parameters_is_an_error() -> None:
    own = replace(PARAMS, battery=BatteryParams(stop_level=0.1, clear_level=0.12))
    bench = Both(own, ("battery.clear_level",))
    with pytest.raises(ValueError, match=r"battery.stop_level = 0.2 does not fit its own"):
        change(bench, "battery.stop_level", "0.15", "0.2")


REPLY = Reply(1, True, "yes", Mode.IDLE)
ENDED = DriveEnded(1, True, "done", DriveReport(1, 1.0, 0.1, 0.2, nan))
ASPECTS: dict[str, tuple[list[Effect], list[Effect], tuple[Aspect, ...]]] = {
    "command": ([PublishTwist(ZERO)], [PublishTwist(Twist(1e-300, 0.0))], (Aspect.COMMAND,)),
    "no command": ([PublishTwist(ZERO)], [], (Aspect.COMMAND,)),
    "mode": (
        [ModeChanged(Mode.MOVING, Mode.IDLE, "a", None)],
        [ModeChanged(Mode.MOVING, Mode.ERROR, "a", Cause.TRACKING_LOST)],
        (Aspect.MODE, Aspect.STOP_CAUSE),
    ),
    "stop cause": (
        [ModeChanged(Mode.MOVING, Mode.ERROR, "a", Cause.ODOMETRY_LOST)],
        [ModeChanged(Mode.MOVING, Mode.ERROR, "a", Cause.TRACKING_LOST)],
        (Aspect.STOP_CAUSE,),
    ),
    "mode alone": (
        [PublishTwist(ZERO), ModeChanged(Mode.MOVING, Mode.IDLE, "a", None)],
        [PublishTwist(ZERO), ModeChanged(Mode.MOVING, Mode.ERROR, "a", None)],
        (Aspect.MODE,),
    ),
    "no answer yet": ([REPLY], [], (Aspect.ANSWER,)),
    "refusal": ([REPLY], [replace(REPLY, ok=False)], (Aspect.ANSWER,)),
    "answer to another": ([REPLY], [replace(REPLY, request_id=2)], (Aspect.ANSWER,)),
    "wording": ([REPLY], [replace(REPLY, message="yes!")], (Aspect.WORDING,)),
}


@pytest.mark.parametrize(("driving", "shadow", "aspects"), ASPECTS.values(), ids=ASPECTS)
def test_each_aspect_of_a_difference_is_named(
    driving: list[Effect], shadow: list[Effect], aspects: tuple[Aspect, ...]
) -> None:
    assert aspects_of(driving, shadow) == aspects


def test_figures_that_are_not_numbers_are_no_difference() -> None:
    shadow = Shadow(PARAMS, State(), ())
    other = replace(ENDED, report=replace(ENDED.report, closure_m=float("nan")))
    assert other != ENDED
    shadow._kernel.step = lambda event: (other,)  # type: ignore[method-assign]
    assert shadow.step(Tick(1), (ENDED,), State()) is None
    assert shadow.differing == 0


@pytest.mark.parametrize(("ours", "theirs"), [("yes", "aye"), ("aye", "yes")])
def test_another_wording_is_a_difference(ours: str, theirs: str) -> None:
    shadow = Shadow(PARAMS, State(), ())
    mine = (replace(REPLY, message=theirs),)
    shadow._kernel.step = lambda event: mine  # type: ignore[method-assign]
    assert shadow.step(Tick(1), (replace(REPLY, message=ours),), State()) == mine
    assert shadow.by_aspect[Aspect.WORDING] == shadow.differing == 1


def test_a_decision_is_told_in_words() -> None:
    effects = (
        PublishTwist(Twist(0.25, -1.0)),
        LatchEmergencyStop("stop", None),
        ReleaseEmergencyStop(),
        ModeChanged(Mode.MOVING, Mode.IDLE, "done", None),
        ENDED,
        REPLY,
        replace(REPLY, ok=False, message="no"),
    )
    assert outcome(effects) == (
        "0.25 m/s, -1 rad/s; latched; released; IDLE: done; drive ended; granted: yes; refused: no"
    )
    assert outcome(()) == "nothing"
    assert contrast(effects, effects[1:]) == ("0.25 m/s, -1 rad/s", "nothing")
    assert contrast(effects[:-1], effects) == ("nothing", "refused: no")


def test_the_driving_kernel_is_not_touched() -> None:
    alone, both = ready(PARAMS), moving_both(SLOW, SLOW_KEYS)
    turn(both, 30)
    again = Kernel(PARAMS)
    assert [effect for event in both.events for effect in again.step(event)] == both.effects
    assert again.state == both.state
    assert alone.kernel.params == both.kernel.params
