"""How well and how fast drives follow their paths, in virtual time.

    python benchmarks/motion.py                                      about 15 seconds
    python benchmarks/motion.py --seeds 5

The base is a differential drive with one wheel that turns 3 % too slowly, a lag of 40 ms, and
odometry at 50 Hz that is exact except for noise of 2 mm and 2 mrad in each sample. Each path is
driven in closed and in open loop; the errors are by odometry, as in `DriveEnded`, and by the true
pose. A lap of the square is compared with the shortest time that the limits allow. Shown are
medians over the seeds of the noise, and the lowest and highest in brackets.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import cos, exp, pi, sin, sqrt
from random import Random
from statistics import mean

from recording.figures import Figure, table

from robotctl.kernel.course import Course
from robotctl.kernel.drive import Drive
from robotctl.kernel.geometry import Pose, wrap_angle
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    DriveEnded,
    DriveRequested,
    Odometry,
    OdomReceived,
    PublishTwist,
    Tick,
    Twist,
)

PERIOD_S = 0.02
TRACK_M = 0.3
WEAK_WHEEL = 0.97
LAG_S = 0.04
NOISE_M, NOISE_RAD = 0.002, 0.002
TODAY_S = 20.7
"""The time of a lap of the 1 m square without speed planning [s], for comparison."""

WAYPOINTS = ((0.0, 0.0), (1.0, 0.0), (1.5, 0.8), (2.5, 0.8), (2.5, -0.5), (0.5, -1.0))
PATHS: dict[str, tuple[Pattern, Course]] = {
    "circle": (Pattern(PatternKind.CIRCLE, 0.5), Course()),
    "figure-eight": (Pattern(PatternKind.FIGURE_EIGHT, 0.5), Course()),
    "waypoints": (Pattern(), Course(waypoints=WAYPOINTS)),
    "square": (Pattern(PatternKind.SQUARE, 1.0), Course()),
    "rounded square": (Pattern(PatternKind.ROUNDED_SQUARE, 1.0), Course()),
}

RMS, MAX = "cross-track RMS [m]", "cross-track maximum [m]"
TRUE_RMS, TRUE_MAX = "RMS in truth [m]", "maximum in truth [m]"
RMS_SHARE, MAX_SHARE = "RMS to that in open loop", "maximum to that in open loop"
LAP, TODAY_SHARE = "a lap [s]", f"a lap to {TODAY_S:g} s"
BOUND_SHARE = "square, a lap to the shortest possible"


def _figures() -> Iterator[Figure]:
    laps_judged = {"square": 0.85, "rounded square": 0.7}
    for name in PATHS:
        judged = name not in laps_judged
        yield Figure(f"{name}, {RMS}", 0.01 if judged else None, digits=".4f")
        yield Figure(f"{name}, {MAX}", 0.03 if judged else None, digits=".4f")
        yield Figure(f"{name}, {TRUE_RMS}", digits=".4f")
        yield Figure(f"{name}, {TRUE_MAX}", digits=".4f")
        yield Figure(f"{name}, {RMS_SHARE}", 0.2 if judged else None, digits=".3f")
        yield Figure(f"{name}, {MAX_SHARE}", 0.2 if judged else None, digits=".3f")
        yield Figure(f"{name}, {LAP}")
        if not judged:
            yield Figure(f"{name}, {TODAY_SHARE}", laps_judged[name], digits=".3f")
    yield Figure(BOUND_SHARE, 1.1, digits=".3f")


FIGURES = tuple(_figures())


class Base:
    """A differential drive whose left wheel turns too slowly."""

    def __init__(self, seed: int) -> None:
        self._random = Random(seed)
        self._wheels = (0.0, 0.0)
        self.truth = Pose()

    def advance(self, command: Twist) -> Odometry:
        """Follow a command for one period, and return a sample of odometry."""
        half = 0.5 * TRACK_M * command.angular
        share = 1.0 - exp(-PERIOD_S / LAG_S)
        left, right = self._wheels
        left += share * (command.linear - half - left)
        right += share * (command.linear + half - right)
        self._wheels = (left, right)
        linear, angular = 0.5 * (WEAK_WHEEL * left + right), (right - WEAK_WHEEL * left) / TRACK_M
        middle = self.truth.theta + 0.5 * angular * PERIOD_S
        self.truth = Pose(
            self.truth.x + linear * PERIOD_S * cos(middle),
            self.truth.y + linear * PERIOD_S * sin(middle),
            wrap_angle(self.truth.theta + angular * PERIOD_S),
        )
        noise = self._random.gauss
        measured = Pose(
            self.truth.x + noise(0.0, NOISE_M),
            self.truth.y + noise(0.0, NOISE_M),
            wrap_angle(self.truth.theta + noise(0.0, NOISE_RAD)),
        )
        return Odometry(measured, Twist(linear, angular), 0)


@dataclass(frozen=True, slots=True)
class Lap:
    """One lap: its duration, and its cross-track errors by odometry and by the true pose."""

    seconds: float
    rms_m: float
    max_m: float
    true_rms_m: float
    true_max_m: float


def drive(pattern: Pattern, course: Course, seed: int) -> Lap:
    """Drive one lap, and return it; in open loop, the robot may be up to 100 m off its path.

    Raises:
        SystemExit: A drive in closed loop was stopped before its end.
    """
    params = KernelParams()
    if course.open_loop:
        params = replace(params, tracking=replace(params.tracking, max_error_m=100.0))
    kernel, base, command = Kernel(params), Base(seed), ZERO
    errors_m: list[float] = []
    for t_ns in _times_ns():
        for event in _events(t_ns, base.advance(command), pattern, course):
            for effect in kernel.step(event):
                if isinstance(effect, PublishTwist):
                    command = effect.twist
                elif isinstance(effect, DriveEnded):
                    if not (effect.completed or course.open_loop):
                        raise SystemExit(f"{pattern.kind.value}, {seed}: {effect.reason}")
                    report = effect.report
                    rms_m = sqrt(mean(error * error for error in errors_m))
                    return Lap(
                        (t_ns - _BEGIN_NS) / 1e9,
                        report.cross_track_rms_m,
                        report.cross_track_max_m,
                        rms_m,
                        max(errors_m),
                    )
        if kernel.state.drive is not None:
            errors_m.append(_off_track_m(kernel.state.drive, base.truth))
    raise AssertionError("the drive did not end")


_PERIOD_NS = round(PERIOD_S * 1e9)
_BEGIN_NS = 5 * _PERIOD_NS


def _times_ns() -> Iterator[int]:
    return iter(range(0, 120_000_000_000, _PERIOD_NS))


def _events(
    t_ns: int, odometry: Odometry, pattern: Pattern, course: Course
) -> Iterator[OdomReceived | BatteryReceived | DriveRequested | Tick]:
    yield OdomReceived(t_ns, odometry)
    yield BatteryReceived(t_ns, 1.0)
    if t_ns == _BEGIN_NS:
        yield DriveRequested(t_ns, 1, pattern, 1, False, "benchmark", course=course)
    yield Tick(t_ns + 1_000_000)


def _off_track_m(driven: Drive, truth: Pose) -> float:
    return driven.cross_track_m(truth)


def shortest_square_s() -> float:
    """Return the time of a 1 m square at 0.5 m/s with the full limits and no lag, jerk or wait."""
    limits, speed_mps = KernelParams().limits, Pattern().speed_mps
    side_s = 1.0 / speed_mps + speed_mps / limits.linear_accel_mps2
    turn_s = 0.5 * pi / limits.angular_rps + limits.angular_rps / limits.angular_accel_rps2
    return 4.0 * (side_s + turn_s)


def measure(seed: int) -> dict[str, float]:
    """Drive each path in closed and in open loop, and return the figures by name."""
    told: dict[str, float] = {}
    for name, (pattern, course) in PATHS.items():
        closed = drive(pattern, course, seed)
        opened = drive(pattern, replace(course, open_loop=True), seed)
        told |= {
            f"{name}, {RMS}": closed.rms_m,
            f"{name}, {MAX}": closed.max_m,
            f"{name}, {TRUE_RMS}": closed.true_rms_m,
            f"{name}, {TRUE_MAX}": closed.true_max_m,
            f"{name}, {RMS_SHARE}": closed.rms_m / opened.rms_m,
            f"{name}, {MAX_SHARE}": closed.max_m / opened.max_m,
            f"{name}, {LAP}": closed.seconds,
            f"{name}, {TODAY_SHARE}": closed.seconds / TODAY_S,
        }
    return told | {BOUND_SHARE: told[f"square, {LAP}"] / shortest_square_s()}


def main() -> int:
    """Print the table; return 1 if a figure is missed, else 0."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    seeds = parser.parse_args().seeds
    lines, missed = table(FIGURES, [measure(seed) for seed in range(seeds)])
    print("| figure | to reach | measured | |\n|---|---|---|---|", *lines, sep="\n")
    print(f"The square cannot take less than {shortest_square_s():.2f} s.")
    print(f"{missed} missed." if missed else "All reached.")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
