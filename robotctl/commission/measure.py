"""What a motion tells about a base: its delay, its stopping distance, its command timeout."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean, linear_regression, median

from robotctl.commission.trial import Motion, Trial
from robotctl.errors import Refused
from robotctl.kernel.geometry import ORIGIN

STEADY_S = 0.8
"""The end of a velocity, in which the base has reached its speed."""

STANDS_S = 0.4
"""The end of a motion, in which the base must stand."""

MOVES_SHARE = 0.2
"""A base moves if its speed is more than this share of the command."""

NEAR_S = 0.02
"""A base stands once it is nearer to its place than it drives in this time."""

MIN_SAMPLES = 3

CLOCKS_DIFFER_S = 1.0
"""A delay of odometry beyond this, or below zero, is the difference of two clocks."""


@dataclass(frozen=True, slots=True)
class Measured:
    """The properties of a base; distances [m] and times as odometry tells them.

    `odometry_delay_s` is from the stamp to the arrival, None where the clocks differ, by
    `clock_offset_s`. `command_delay_s` is the time by which the motion, as odometry tells it,
    follows the command: all delays and the lag of the base. `stopping_m` and `stopping_s` are from
    the command of zero to the standstill. `base_timeout_s` is how long the base goes on without a
    command, None if it was still moving after `quiet_s`.
    """

    odometry_hz: float
    odometry_gap_s: float
    odometry_delay_s: float | None
    clock_offset_s: float
    commanded_mps: float
    reached_mps: float
    command_delay_s: float
    stopping_m: float
    stopping_s: float
    base_timeout_s: float | None
    quiet_s: float


@dataclass(frozen=True, slots=True)
class _Line:
    """The way of a base at constant speed: x = speed * (t - since), 0 where it stood before."""

    speed_mps: float
    since_s: float

    def at(self, t_s: float) -> float:
        return self.speed_mps * (t_s - self.since_s)


def measured(trial: Trial) -> Measured:
    """Return what two motions tell, of which the first ended by zero, the second by silence.

    Raises:
        Refused: There is another number of motions, or the base did not move, or did not stop.
    """
    if [motion.held.quiet_s > 0.0 for motion in trial.motions] != [False, True]:
        raise Refused(f"{len(trial.motions)} motions, and not the two of a commissioning")
    stopped, unheard = trial.motions
    line = _line(stopped)
    stopping_m, stopping_s = _stop(stopped, line)
    gaps_s = [after.t_s - before.t_s for before, after in pairwise(trial.samples)]
    delay_s = median(sample.delay_s for sample in trial.samples)
    differ = not 0.0 <= delay_s <= CLOCKS_DIFFER_S
    return Measured(
        odometry_hz=1.0 / fmean(gaps_s),
        odometry_gap_s=max(gaps_s),
        odometry_delay_s=None if differ else delay_s,
        clock_offset_s=delay_s if differ else 0.0,
        commanded_mps=stopped.held.linear_mps,
        reached_mps=line.speed_mps,
        command_delay_s=max(line.since_s - _commanded_since_s(stopped), 0.0),
        stopping_m=stopping_m,
        stopping_s=stopping_s,
        base_timeout_s=_timeout_s(unheard, stopping_m),
        quiet_s=unheard.held.quiet_s,
    )


def _last_s(motion: Motion) -> float:
    """Return when the velocity was commanded last."""
    wanted = motion.held.linear_mps
    return max((each.t_s for each in motion.commands if each.linear_mps == wanted), default=0.0)


def _commanded_since_s(motion: Motion) -> float:
    """Return when a velocity that begins at once would have led as far as its ramp."""
    last_s = _last_s(motion)
    sent = [each for each in motion.commands if each.t_s <= last_s]
    driven_m = sum(before.linear_mps * (after.t_s - before.t_s) for before, after in pairwise(sent))
    return last_s - driven_m / motion.held.linear_mps


def _way(motion: Motion) -> list[tuple[float, float]]:
    """Return time and distance forward of each sample, from the first one on."""
    begin = motion.samples[0].pose if motion.samples else ORIGIN
    return [(each.t_s, begin.express(each.pose).x) for each in motion.samples]


def _line(motion: Motion) -> _Line:
    """Return the line through the steady part.

    Raises:
        Refused: The base did not move, or told too little.
    """
    last_s, wanted = _last_s(motion), motion.held.linear_mps
    steady = [(t_s, x) for t_s, x in _way(motion) if last_s - STEADY_S <= t_s <= last_s]
    if len(steady) < MIN_SAMPLES:
        raise Refused(f"{len(steady)} samples of odometry in {STEADY_S:g} s are too few to measure")
    fit = linear_regression(*zip(*steady, strict=True))
    if fit.slope < MOVES_SHARE * wanted:
        raise Refused(
            f"the base went on at {fit.slope:.3f} m/s where {wanted:g} m/s was commanded",
            "see whether it is switched on, and not below the smallest speed that it can drive",
        )
    return _Line(fit.slope, -fit.intercept / fit.slope)


def _rest(motion: Motion, from_s: float, until_s: float) -> tuple[float, bool]:
    """Return where the base was at the end of a time, and whether it stood then."""
    xs = [x for t_s, x in _way(motion) if from_s <= t_s <= until_s]
    if len(xs) < MIN_SAMPLES - 1:
        raise Refused("odometry ended before the base stood")
    limit_m = MOVES_SHARE * motion.held.linear_mps * (until_s - from_s)
    return fmean(xs), max(xs) - min(xs) <= limit_m


def _stop(motion: Motion, line: _Line) -> tuple[float, float]:
    """Return distance and time from the first command of zero to the standstill.

    Raises:
        Refused: The base did not stand in the end.
    """
    last_s, way = _last_s(motion), _way(motion)
    zero_s = min((each.t_s for each in motion.commands if each.t_s > last_s), default=last_s)
    end_s = way[-1][0]
    rest_m, stands = _rest(motion, end_s - STANDS_S, end_s)
    if not stands:
        raise Refused("the base was still moving when the motion was over", "stop it by hand")
    near_m = NEAR_S * line.speed_mps
    stood_s = max((t_s for t_s, x in way if abs(x - rest_m) > near_m), default=zero_s)
    return max(rest_m - line.at(zero_s), 0.0), max(stood_s - zero_s, 0.0)


def _timeout_s(motion: Motion, stopping_m: float) -> float | None:
    """Return how long the base went on after the last command, beyond its stopping distance."""
    last_s, line = _last_s(motion), _line(motion)
    end_s = last_s + motion.held.quiet_s
    rest_m, stands = _rest(motion, end_s - STANDS_S, end_s)
    if not stands:
        return None
    return max(rest_m - line.at(last_s) - stopping_m, 0.0) / line.speed_mps
