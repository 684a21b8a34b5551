"""The invariants hold for all events: finite, within limits, zero outside MOVING, one reply.

The same events give the same effects, bit for bit: in any process, and from any snapshot.
A step keeps all fields that it does not change.
Seeded schedules of faults over all inputs, and a day of driving, on a virtual clock.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import isfinite
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from robotctl.check.closed_loop import closed_loop
from robotctl.check.invariants import Invariants
from robotctl.kernel.codec import Snapshot, from_json, to_json
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import Course
from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.state import State, latched
from robotctl.kernel.types import (
    ZERO,
    Cause,
    CommandPublishersSeen,
    DriveEnded,
    DriveRequested,
    Effect,
    Event,
    FaultReported,
    LatchEmergencyStop,
    LeaseRequested,
    LoopStalled,
    ModeChanged,
    ModeRequested,
    ParameterRequested,
    Phase,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    ResetRequested,
    Tick,
    Twist,
)
from robotctl.sim import SimParams
from robotctl.testing.kernels import (
    TICK_NS,
    Bench,
    drive_simulated,
    in_mode,
    moving,
    ready,
    reset,
    stopping,
)
from tests.kernel import strategies
from tests.kernel.fed_kernel import LONGEST_TICKS, MOMENTARY, PROVOKED, FedKernel
from tests.support.cases import for_each

REQUESTS = (ModeRequested, ResetRequested, DriveRequested, ParameterRequested, LeaseRequested)
RELEASES = (0,)
"""The only mode number whose request leaves EMERGENCY_STOP."""


class Auditor:
    """Checks every step of a kernel, and raises AssertionError when an invariant is broken."""

    def __init__(self, state: State, params: KernelParams) -> None:
        self.mode = state.mode
        self.command = state.command
        self.params = params
        self.tick_t_ns = state.tick_t_ns
        self.open = set(state.waiting)

    def step(self, kernel: Kernel, event: Event) -> tuple[Effect, ...]:
        """Take the step and check it."""
        effects = kernel.step(event)
        self.params = kernel.params
        if isinstance(event, REQUESTS):
            self.open.add(event.request_id)
        latched_now = False
        for effect in effects:
            if isinstance(effect, ModeChanged):
                self._changed(effect, event)
            elif isinstance(effect, PublishTwist):
                self._published(effect.twist, event)
            elif isinstance(effect, Reply):
                assert effect.request_id in self.open, "answered twice, or never asked"
                self.open.remove(effect.request_id)
                assert effect.message
                assert effect.mode is self.mode is kernel.state.mode, "said before it happened"
            elif isinstance(effect, LatchEmergencyStop):
                latched_now = True
                assert ModeChanged in {type(other) for other in effects}
        state = kernel.state
        assert self.mode is state.mode, "the mode changed without a ModeChanged"
        assert latched_now == self._entered_stop(effects)
        assert self.open == set(state.waiting), "a request without an answer"
        assert (state.drive is not None) == (state.mode is Mode.MOVING)
        assert (state.phase is Phase.STANDING) == (state.mode is not Mode.MOVING)
        assert (state.cause is not None) == (state.mode in (Mode.ERROR, Mode.EMERGENCY_STOP))
        if isinstance(event, Tick):
            assert sum(isinstance(effect, PublishTwist) for effect in effects) == 1
            self.tick_t_ns = event.t_ns
        elif isinstance(event, LoopStalled):  # the watchdog has sent zeros until now
            self.command, self.tick_t_ns = ZERO, event.t_ns
        return effects

    @staticmethod
    def _entered_stop(effects: Sequence[Effect]) -> bool:
        return any(
            isinstance(effect, ModeChanged) and effect.mode is Mode.EMERGENCY_STOP
            for effect in effects
        )

    def _changed(self, change: ModeChanged, event: Event) -> None:
        assert change.previous is self.mode is not change.mode
        if self.mode is Mode.EMERGENCY_STOP:
            assert change.mode is Mode.IDLE
            assert isinstance(event, ResetRequested) or (
                isinstance(event, ModeRequested) and event.requested in RELEASES
            )
        self.mode = change.mode

    def _published(self, twist: Twist, event: Event) -> None:
        limits = self.params.limits
        assert isfinite(twist.linear)
        assert isfinite(twist.angular)
        assert abs(twist.linear) <= limits.linear_mps
        assert abs(twist.angular) <= limits.angular_rps
        if twist != ZERO:
            assert self.mode is Mode.MOVING
            assert isinstance(event, Tick)
            assert self.tick_t_ns is not None
            dt_s = max(event.t_ns - self.tick_t_ns, 0) / 1e9
            slack = 1e-9
            gained = abs(twist.linear - self.command.linear)
            assert gained <= limits.linear_accel_mps2 * dt_s + slack
            gained = abs(twist.angular - self.command.angular)
            assert gained <= limits.angular_accel_rps2 * dt_s + slack
        self.command = twist


ids = iter(range(1, 10**12))
REQUEST_ID = st.builds(lambda: next(ids))
ANY_EVENTS = st.lists(strategies.event(strategies.INT64, REQUEST_ID), max_size=40)


@given(ANY_EVENTS, st.sampled_from(("fresh", "latched", "ready", "moving")))
@settings(max_examples=100)
def test_every_promise_holds_for_any_events_at_any_times(events: list[Event], begin: str) -> None:
    state = {
        "fresh": State(),
        "latched": latched("before"),
        "ready": ready().state,
        "moving": moving().state,
    }[begin]
    kernel = Kernel(KernelParams(), state)
    auditor = Auditor(state, kernel.params)
    for event in events:
        auditor.step(kernel, event)


@given(ANY_EVENTS)
@settings(max_examples=40)
def test_an_emergency_stop_is_possible_at_any_moment(events: list[Event]) -> None:
    bench = moving()
    for event in events:
        bench.kernel.step(event)
    effects = bench.kernel.step(ModeRequested(bench.t_ns, next(ids), 3, "test"))
    assert effects[0] == PublishTwist(ZERO)
    assert isinstance(effects[-1], Reply)
    assert effects[-1].ok
    assert bench.state.mode is Mode.EMERGENCY_STOP
    for event in events:
        if not isinstance(event, ResetRequested) and not (
            isinstance(event, ModeRequested) and event.requested == 0
        ):
            bench.kernel.step(event)
    assert bench.state.mode is Mode.EMERGENCY_STOP


@given(
    st.builds(
        VelocityLimits,
        st.floats(0.01, 10.0),
        st.floats(0.01, 20.0),
        st.floats(0.01, 20.0),
        st.floats(0.01, 60.0),
        st.floats(0.0, 0.5),
    ),
    st.floats(5.0, 1000.0),
    strategies.PATTERN,
    st.integers(0, 2),
    st.lists(st.integers(0, 400_000_000), min_size=20, max_size=60),
    strategies.COURSE,
)
@settings(max_examples=50)
def test_every_allowed_configuration_keeps_every_promise(
    limits: VelocityLimits,
    rate_hz: float,
    pattern: Pattern,
    laps: int,
    gaps_ns: list[int],
    course: Course,
) -> None:
    params = replace(KernelParams(), limits=limits, rate_hz=rate_hz, max_tick_gap_s=5.0)
    bench = ready(params)
    auditor = Auditor(bench.state, params)
    begin = DriveRequested(bench.t_ns, next(ids), pattern, laps, False, "test", course=course)
    auditor.step(bench.kernel, begin)
    for gap_ns in gaps_ns:
        drive = bench.state.drive
        pose = drive.reference().pose if drive else None
        if pose is not None:
            bench.odometry(pose, 0)
        bench.t_ns += gap_ns
        auditor.step(bench.kernel, Tick(bench.t_ns))


class AnyHistory(RuleBasedStateMachine):
    """A robot whose inputs are plausible most of the time."""

    @initialize(laps=st.integers(0, 1), begin=st.sampled_from((None, "latched")))
    def begin(self, laps: int, begin: str | None) -> None:
        self.bench = Bench(state=latched("before") if begin else State())
        self.auditor = Auditor(self.bench.state, self.bench.kernel.params)
        self.laps = laps
        self.snapshot = self._snapshot()
        self.since: list[tuple[Event, tuple[Effect, ...]]] = []

    def _snapshot(self) -> str:
        return to_json(Snapshot("test", self.bench.kernel.params, self.bench.state))

    def _give(self, event: Event) -> tuple[Effect, ...]:
        effects = self.auditor.step(self.bench.kernel, event)
        self.since.append((event, effects))
        return effects

    @rule(ticks=st.integers(1, 40), follows=st.booleans())
    def healthy_time_passes(self, ticks: int, follows: bool) -> None:
        from robotctl.kernel.geometry import Pose
        from robotctl.kernel.types import BatteryReceived, Odometry, OdomReceived

        bench = self.bench
        for _ in range(ticks):
            drive, last = bench.state.drive, bench.state.health.odometry
            pose = last.pose if last else Pose()
            if drive is not None and follows:
                pose = drive.reference().pose
            self._give(OdomReceived(bench.t_ns, Odometry(pose, ZERO, bench.t_ns)))
            self._give(BatteryReceived(bench.t_ns, 1.0))
            bench.t_ns += TICK_NS
            self._give(Tick(bench.t_ns))

    @rule(number=strategies.MODE_NUMBER)
    def a_mode_is_requested(self, number: int) -> None:
        self._give(ModeRequested(self.bench.t_ns, next(ids), number, "test"))

    @rule()
    def moving_is_requested(self) -> None:
        self._give(ModeRequested(self.bench.t_ns, next(ids), 1, "test"))

    @rule(
        pattern=strategies.PATTERN,
        laps=st.integers(0, 2),
        replacing=st.booleans(),
        course=strategies.COURSE,
    )
    def a_drive_is_requested(
        self, pattern: Pattern, laps: int, replacing: bool, course: Course
    ) -> None:
        now = self.bench.t_ns
        event = DriveRequested(now, next(ids), pattern, laps, replacing, "test", course=course)
        effects = self._give(event)
        if any(isinstance(effect, DriveEnded) for effect in effects):
            assert replacing

    @rule()
    def reset(self) -> None:
        self._give(ResetRequested(self.bench.t_ns, next(ids), "test"))

    @rule(data=st.data())
    def anything_happens(self, data: st.DataObject) -> None:
        now = st.just(self.bench.t_ns)
        self._give(data.draw(strategies.event(now, REQUEST_ID)))

    @precondition(lambda self: self.bench.state.mode is Mode.EMERGENCY_STOP)
    @rule()
    def a_stop_stays_latched_until_it_is_released(self) -> None:
        before = self.bench.state.mode
        self._give(Tick(self.bench.t_ns))
        assert self.bench.state.mode is before

    @rule()
    def a_file_begins(self) -> None:
        """The journal so far gives the same effects in a kernel made of its snapshot."""
        kernel = from_json(Snapshot, self.snapshot).kernel()
        for event, effects in self.since:
            read: Any = from_json(type(event), to_json(event))
            again = kernel.step(read)
            assert list(map(to_json, again)) == list(map(to_json, effects))
        assert to_json(kernel.state) == to_json(self.bench.state)
        self.snapshot = self._snapshot()
        self.since.clear()

    @invariant()
    def the_release_is_never_forgotten(self) -> None:
        releases = [
            effects
            for _, effects in getattr(self, "since", [])
            if any(isinstance(effect, ReleaseEmergencyStop) for effect in effects)
        ]
        for effects in releases:
            assert any(
                isinstance(effect, ModeChanged) and effect.previous is Mode.EMERGENCY_STOP
                for effect in effects
            )


TestAnyHistory = AnyHistory.TestCase
TestAnyHistory.settings = settings(max_examples=25, stateful_step_count=30)

HISTORY = """
import hashlib
from robotctl.kernel.codec import to_json
from robotctl.kernel.types import Cause, CommandPublishersSeen, FaultCleared, FaultReported
from robotctl.testing.kernels import moving
bench = moving(ticks=60)
bench.give(CommandPublishersSeen(bench.t_ns, ("/b", "/a", "/c")))
for cause in (Cause.TASK_DIED, Cause.LOOP_STALLED, Cause.RECORDER_FAILED):
    bench.give(FaultReported(bench.t_ns, cause, "broken"))
bench.give(FaultCleared(bench.t_ns, Cause.LOOP_STALLED))
for number in (0, 1, 2, 3, 4):
    bench.request(number)
lines = [to_json(effect) for effect in bench.effects] + [to_json(bench.state)]
print(len(lines), hashlib.sha256("".join(lines).encode()).hexdigest())
"""


def run_with_hash_seed(seed: int) -> str:
    return subprocess.run(
        [sys.executable, "-c", HISTORY],
        env={**os.environ, "PYTHONHASHSEED": str(seed)},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout


def test_the_hash_seed_changes_nothing() -> None:
    outputs = {run_with_hash_seed(seed) for seed in (0, 1, 4_294_967_295)}
    assert len(outputs) == 1


def test_events_fed_again_from_a_snapshot_in_their_midst_give_the_same_effects() -> None:
    driven = drive_simulated(Pattern(PatternKind.FIGURE_EIGHT, 0.3))
    kernel = Kernel(KernelParams())
    journal: list[tuple[Event, tuple[Effect, ...]]] = []
    snapshots: dict[int, str] = {}
    for number, event in enumerate(driven.events):
        if number % 300 == 0:
            snapshots[number] = to_json(Snapshot("test", kernel.params, kernel.state))
        journal.append((event, kernel.step(event)))
    assert len(snapshots) > 3
    for begin, text in snapshots.items():
        fresh = from_json(Snapshot, text).kernel()
        for event, effects in journal[begin:]:
            again: Any = from_json(type(event), to_json(event))
            assert fresh.step(again) == effects
        assert to_json(fresh.state) == to_json(kernel.state)


def test_a_step_leaves_the_state_before_it_untouched() -> None:
    bench = moving()
    before, text = bench.state, to_json(bench.state)
    bench.run(20)
    bench.request(0)
    assert to_json(before) == text != to_json(bench.state)


SITUATIONS: dict[str, Callable[[], Bench]] = {
    "stopping": stopping,
    "in error": lambda: in_mode(Mode.ERROR),
    "standing beside others": lambda: beside_others(in_mode(Mode.IDLE)),
}


def beside_others(bench: Bench) -> Bench:
    bench.give(CommandPublishersSeen(bench.t_ns, ("/teleop",)))
    bench.give(FaultReported(bench.t_ns, Cause.DAEMON_ENDS, "told to stop"))
    bench.t_ns += 400_000_000
    bench.battery(0.9)  # learned in a gap between ticks
    assert bench.state.health.tick_gap_s
    return bench


@for_each("situation", SITUATIONS)
def test_odometry_changes_what_is_known_of_odometry_alone(situation: str) -> None:
    bench = SITUATIONS[situation]()
    before = bench.state
    bench.odometry(Pose(0.01, 0.0, 0.0))
    after = bench.state
    assert replace(after, health=before.health, drive=before.drive) == before
    told = ("odometry", "odometry_t_ns", "odometry_stamp_ns", "path_error_m")
    assert (
        replace(after.health, **{name: getattr(before.health, name) for name in told})
        == before.health
    )


@for_each("situation", SITUATIONS)
def test_a_tick_changes_command_and_drive_alone(situation: str) -> None:
    bench = SITUATIONS[situation]()
    before = bench.state
    bench.t_ns = before.tick_t_ns or 0
    bench.tick()
    after = bench.state
    assert after.mode is before.mode
    changed = {name: getattr(before, name) for name in ("command", "tick_t_ns", "drive", "health")}
    assert replace(after, **changed) == before
    assert replace(after.health, tick_gap_s=before.health.tick_gap_s) == before.health


FAULTS_OF_A_SCHEDULE = 6


class CheckedKernel(FedKernel):
    """A fed kernel whose every step is held against the invariants of recordings."""

    def __init__(self) -> None:
        self.invariants: Invariants | None = None
        super().__init__()
        self.invariants = Invariants()
        self.invariants.snapshot(Snapshot("test", self.kernel.params, self.state))

    def give(self, event: Event) -> tuple[object, ...]:  # type: ignore[override]
        effects = super().give(event)
        self.events.clear()  # a day of them does not fit into memory
        self.effects = self.effects[-100:]
        if self.invariants is not None:
            self.invariants.step(0, event, effects)
        return effects


def recovered(fed: CheckedKernel) -> bool:
    """Return whether the robot moves again once all is well."""
    fed.turn(2 * LONGEST_TICKS)
    if fed.state.mode in (Mode.ERROR, Mode.EMERGENCY_STOP):
        reset(fed)
    if fed.state.mode is Mode.IDLE:
        fed.request(Mode.MOVING)
    return fed.state.mode is Mode.MOVING


def follow(seed: int) -> Iterator[str]:
    """Follow a schedule of faults, requests and resets; yield what must not be."""
    random, fed = Random(seed), CheckedKernel()
    fed.request(Mode.MOVING)  # now the fence has its place
    causes = sorted(PROVOKED, key=lambda cause: cause.value)
    for _ in range(FAULTS_OF_A_SCHEDULE):
        present: dict[str, Cause] = {}
        for cause in random.sample(causes, random.randint(1, 3)):
            if PROVOKED[cause].feed not in present:
                present[PROVOKED[cause].feed] = cause
                PROVOKED[cause].begin(fed)
                fed.turn(random.randint(0, LONGEST_TICKS))
        if random.random() < 0.3:
            MOMENTARY[random.choice(sorted(MOMENTARY, key=lambda cause: cause.value))](fed)
        fed.request(random.randint(0, 4))
        fed.turn(LONGEST_TICKS)
        if fed.state.mode is not Mode.MOVING and fed.state.command != ZERO:
            yield f"seed {seed}: a command in {fed.state.mode.name}"
        for cause in present.values():
            PROVOKED[cause].end(fed)
        if not recovered(fed):
            yield f"seed {seed}: after {present} {fed.replies[-1].message}"
    assert fed.invariants is not None
    fed.invariants.end(fed.state.waiting)
    yield from (f"seed {seed}: {each.text}" for each in fed.invariants.violations)


def test_after_any_schedule_of_faults_every_invariant_holds_and_the_robot_moves_again() -> None:
    assert [problem for seed in range(10) for problem in follow(seed)] == []


@pytest.mark.slow
def test_after_each_of_500_schedules_every_invariant_holds_and_the_robot_moves_again() -> None:
    assert [problem for seed in range(20, 520) for problem in follow(seed)] == []


@pytest.mark.slow
def test_a_day_of_driving_neither_drifts_nor_grows() -> None:
    kernel = Kernel(replace(KernelParams(), rate_hz=10.0))
    begin = DriveRequested(NS_PER_S, 1, Pattern(PatternKind.CIRCLE, 1.0, 0.3), 0, False, "test")
    sim = SimParams(odometry_rate_hz=10.0, battery_life_s=1e6)
    invariants = Invariants()
    invariants.snapshot(Snapshot("test", kernel.params, kernel.state))
    hour, sizes, worst_m = 0, [], 0.0
    for event, effects in closed_loop(kernel, sim, [begin], 0):
        invariants.step(0, event, effects)
        if event.t_ns > 2 * NS_PER_S:
            assert kernel.state.mode is Mode.MOVING, kernel.state.reason
            worst_m = max(worst_m, kernel.state.health.path_error_m)
        if event.t_ns > hour * 3600 * NS_PER_S:
            sizes.append(len(repr(kernel.state)))
            hour += 1
        if hour > 24:
            break
    assert max(sizes[2:]) < min(sizes[2:]) + 200
    assert worst_m < 0.2
    assert invariants.count == 0
