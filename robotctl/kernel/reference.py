"""The reference of a drive: where the robot should be, and how it moves along the path.

A lead moves by the speed plan, with steps in its acceleration. The reference follows it with the
mean of its speeds in the last ticks: a moving average limits the jerk, and keeps speed and
acceleration within those of the plan (Biagiotti and Melchiorri 2012). Where the robot stops, the
lead waits until the reference and the robot have arrived.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import fsum, nan, sqrt

from robotctl.kernel.speed_plan import Leg

SETTLE_S = 0.6
"""The longest time that the reference waits at a stop for the robot to arrive."""

ARRIVED = 1e-9
"""Less than this [m, rad] is rounding, and might never become 0: a lead so near to a stop is there,
one so little ahead is where the reference is, and a reference that is slower per second stands."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the reference has come.

    `length` is its position in segment `segment` (m, or rad in a turn), `speed` its rate per second
    and `accel` the change of that. `settling_s` is how long it has waited at a stop. `closure_m` is
    the distance of the robot from the end of the lap at the end of the last lap, NaN before that.
    The lead is `ahead` of the reference, at `lead_speed`; `rates` are its speeds in the last ticks.
    """

    laps: int = 0
    segment: int = 0
    length: float = 0.0
    speed: float = 0.0
    settling_s: float = 0.0
    closure_m: float = nan
    ahead: float = 0.0
    lead_speed: float = 0.0
    rates: tuple[float, ...] = ()
    accel: float = 0.0


def begun(speed: float, ticks: int, dt_s: float, legs: tuple[Leg, ...], *, turns: bool) -> Progress:
    """Return the progress of a reference that begins at `speed`, as if it had come from before."""
    ahead = 0.5 * speed * dt_s * (ticks - 1)
    if turns or speed <= 0.0 or legs[0].length <= ahead:
        return Progress()
    return Progress(speed=speed, ahead=ahead, lead_speed=speed, rates=(speed,) * (ticks - 1))


def advanced(
    at: Progress, legs: tuple[Leg, ...], laps: int, dt_s: float, ticks: int
) -> tuple[Progress, bool]:
    """Return the reference after `dt_s`, and whether it stands at a stop now.

    `laps` is how many laps there are in all, 0 for no end; an acceleration builds up over `ticks`.
    """
    # Where the lead is.
    index, lap, lead, ahead = at.segment, at.laps, at.length + at.ahead, at.ahead
    leg = legs[index]
    end_speed = leg.last_end_speed if lap == laps - 1 else leg.end_speed
    while lead >= leg.length:
        if end_speed == 0.0:
            ahead -= lead - leg.length
            lead = leg.length
            break
        lead -= leg.length
        index += 1
        if index == len(legs):
            index, lap = 0, lap + 1
        leg = legs[index]
        end_speed = leg.last_end_speed if lap == laps - 1 else leg.end_speed
    # How it moves.
    left = leg.length - lead
    speed = min(at.lead_speed + leg.accel * dt_s, leg.top_speed)
    # Braking in ticks takes half a tick longer than braking in theory.
    brakes_from, half = end_speed * end_speed + 2.0 * leg.accel * left, 0.5 * leg.accel * dt_s
    if speed * (speed + 2.0 * half) > brakes_from:
        speed = sqrt(half * half + brakes_from) - half
    move = speed * dt_s
    stands = end_speed == 0.0 and move >= left - ARRIVED
    if stands:
        move, speed = left, 0.0
    rates = (*at.rates, move / dt_s)[-ticks:]
    ahead += move
    # What the reference takes over.
    rate = fsum(rates) / ticks
    part = min(rate * dt_s, ahead)
    ahead -= part
    if stands and (ahead < ARRIVED or rate < ARRIVED):
        return Progress(lap, index, leg.length, rate, at.settling_s, at.closure_m), True
    index, lap, length = at.segment, at.laps, at.length + part
    leg = legs[index]
    while length >= leg.length:
        length -= leg.length
        index += 1
        if index == len(legs):
            index, lap = 0, lap + 1
        leg = legs[index]
    accel = (rate - at.speed) / dt_s
    at = Progress(lap, index, length, rate, 0.0, at.closure_m, ahead, speed, rates, accel)
    return at, False


START = Progress()
