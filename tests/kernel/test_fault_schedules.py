"""Seeded schedules of faults over all inputs, and a day of driving, on a virtual clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from random import Random

import pytest

from robotctl.kernel.codec import Snapshot
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import ZERO, Cause, DriveRequested, Event
from robotctl.kernel.units import NS_PER_S
from robotctl.rerun.closed_loop import closed_loop
from robotctl.rerun.invariants import Invariants
from robotctl.sim.robot import SimParams
from robotctl.testing.kernels import reset
from tests.support.fed_kernel import LONGEST_TICKS, MOMENTARY, PROVOKED, FedKernel

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


@pytest.mark.parametrize("first", [0, 10])
def test_after_any_schedule_of_faults_every_invariant_holds_and_the_robot_moves_again(
    first: int,
) -> None:
    assert [problem for seed in range(first, first + 10) for problem in follow(seed)] == []


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
