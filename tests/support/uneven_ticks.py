"""Motions on virtual time whose ticks come early, late or not at all, with samples lost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import repeat
from math import inf
from random import Random

from robotctl.kernel.course import Course
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, VelocityLimits
from robotctl.kernel.patterns import Pattern, path_of
from robotctl.kernel.reference import SETTLE_S, Progress, advanced
from robotctl.kernel.speed_plan import speed_plan
from robotctl.kernel.types import (
    BatteryReceived,
    DriveEnded,
    Event,
    Odometry,
    OdomReceived,
    PublishTwist,
    Tick,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.sim.robot import Robot, SimParams

BEGIN_NS = NS_PER_S

GAPS: dict[str, Callable[[Random], float]] = {
    "exact": lambda draw: 1.0,
    "a little early and late": lambda draw: draw.gauss(1.0, 0.025),
    "early and late": lambda draw: max(draw.gauss(1.0, 0.4), 1e-6),
    "late": lambda draw: draw.choice((1.0, 1.0, 1.5, 1.9)),
    "missed": lambda draw: draw.choice((1.0, 1.0, 2.0, 4.0)),
    "in bursts": lambda draw: draw.choice((1.0, 2.0, 1e-4, 1e-6)),
    "two at once": lambda draw: draw.choice((1.0, 0.0)),
}
"""The time between two ticks in periods, by what the ticks are."""


@dataclass(frozen=True, slots=True)
class Ran:
    """A motion until it ended: `counted_s` counts at most two periods for each gap."""

    ended: DriveEnded
    seconds: float
    counted_s: float


class Endless(AssertionError):
    """A motion did not end in time."""


def run_unevenly(
    params: KernelParams,
    sim: SimParams,
    begin: Event,
    gaps: str,
    seed: int,
    most_s: float,
    later: Sequence[Event] = (),
) -> Ran:
    """Run a motion to its end; `most_s` is how much of `counted_s` it may take.

    `later` are events that follow, in the order of time.

    Raises:
        Endless: It does not end in time.
        AssertionError: It does not begin.
    """
    draw, kernel, robot = Random(f"{gaps} {seed}"), Kernel(params), Robot(sim)
    period_s, sample_s = 1.0 / params.rate_hz, 1.0 / sim.odometry_rate_hz
    t_s = next_sample_s = next_battery_s = BEGIN_NS / NS_PER_S
    counted_s, requests = 0.0, [begin, *later]
    begun_s: float | None = None

    def give(event: Event) -> DriveEnded | None:
        ended = None
        for effect in kernel.step(event):
            if isinstance(effect, PublishTwist):
                robot.command(effect.twist)
            elif isinstance(effect, DriveEnded):
                ended = effect
        return ended

    while True:
        gap_s = GAPS[gaps](draw) * period_s
        t_s += gap_s
        if begun_s is not None:
            counted_s += min(gap_s, 2.0 * period_s)
        ended = None
        while next_sample_s <= t_s and ended is None:
            robot.advance(sample_s)
            at_ns = round(next_sample_s * NS_PER_S)
            if draw.random() > 0.02 or gaps == "exact":  # else lost
                ended = give(OdomReceived(at_ns, Odometry(robot.odometry, robot.measured, at_ns)))
            next_sample_s += sample_s
        if next_battery_s <= t_s:
            give(BatteryReceived(round(next_battery_s * NS_PER_S), 1.0))
            next_battery_s += 1.0
        t_ns = round(t_s * NS_PER_S)
        while requests and requests[0].t_ns <= t_ns and ended is None:
            ended = give(requests.pop(0))
            if begun_s is None:
                begun_s = t_s
                assert kernel.state.mode is Mode.MOVING, kernel.state.health
        ended = ended or give(Tick(t_ns))
        if ended is not None and begun_s is not None:
            return Ran(ended, t_s - begun_s, counted_s)
        if counted_s > most_s:
            raise Endless(f"{counted_s:.1f} s and not ended: {kernel.state.drive}")


def planned_s(
    pattern: Pattern, course: Course, laps: int, limits: VelocityLimits, rate_hz: float
) -> float:
    """Return how long a drive takes whose robot needs as long as it may at each stop.

    inf stands for a drive of more than 10,000 ticks.
    """
    if course.held is not None:
        return course.held.for_s + course.held.quiet_s
    path = path_of(pattern, course, again=laps != 1)
    legs = speed_plan(path, pattern.speed_mps, limits)
    ticks = max(1, round(limits.accel_rise_s * rate_hz))
    at, seconds = Progress(), 0.0
    for _ in repeat(None, 10_000):
        at, stands = advanced(at, legs, laps, 1.0 / rate_hz, ticks)
        seconds += 1.0 / rate_hz
        if stands:
            seconds += SETTLE_S
            if at.segment + 1 < len(legs):
                at = Progress(at.laps, at.segment + 1)
            else:
                at = Progress(at.laps + 1)
        if at.laps >= laps:
            return seconds
    return inf


def ramp_s(limits: VelocityLimits) -> float:
    """Return how long the longest ramp to zero takes."""
    return max(
        limits.linear_mps / limits.linear_accel_mps2, limits.angular_rps / limits.angular_accel_rps2
    )
