"""How well and how fast drives follow their paths, on virtual time.

    python benchmarks/motion.py [--seeds 5] [--json FILE]

The base is a differential drive with one wheel that turns 3 % too slowly, a lag of 40 ms, and
odometry that is exact but for noise of 2 mm and 2 mrad in each sample, at 50 Hz. Each path is
driven in closed and in open loop; the errors are against odometry, as `DriveEnded` tells them, and
against the true pose. The times of a lap are held against the shortest time that the limits allow.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from math import cos, exp, inf, pi, sin, sqrt
from pathlib import Path
from random import Random
from statistics import mean

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
"""A lap of the 1 m square before the speed was planned ahead."""

WAYPOINTS = ((0.0, 0.0), (1.0, 0.0), (1.5, 0.8), (2.5, 0.8), (2.5, -0.5), (0.5, -1.0))
PATHS: dict[str, tuple[Pattern, Course]] = {
    "circle": (Pattern(PatternKind.CIRCLE, 0.5), Course()),
    "figure-eight": (Pattern(PatternKind.FIGURE_EIGHT, 0.5), Course()),
    "waypoints": (Pattern(), Course(waypoints=WAYPOINTS)),
    "square": (Pattern(PatternKind.SQUARE, 1.0), Course()),
    "rounded-square": (Pattern(PatternKind.ROUNDED_SQUARE, 1.0), Course()),
}


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
    """One lap: its duration, and its cross-track errors by odometry and in truth."""

    seconds: float
    rms_m: float
    max_m: float
    true_rms_m: float
    true_max_m: float
    completed: bool


def drive(pattern: Pattern, course: Course, seed: int) -> Lap:
    """Drive one lap; an open loop may leave its path as far as it will."""
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
                    report = effect.report
                    rms_m = sqrt(mean(error * error for error in errors_m))
                    return Lap(
                        (t_ns - _BEGIN_NS) / 1e9,
                        report.cross_track_rms_m,
                        report.cross_track_max_m,
                        rms_m,
                        max(errors_m),
                        effect.completed,
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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    laps: dict[str, list[Lap]] = {}
    for name, (pattern, course) in PATHS.items():
        for loop, how in (("closed", course), ("open", replace(course, open_loop=True))):
            laps[f"{name} {loop}"] = [drive(pattern, how, seed) for seed in range(given.seeds)]
    head = f"{'RMS':>7} {'max':>7}  {'true':>6} {'max':>7}  {'lap [s]':>7}"
    print(f"{'worst of the seeds [m]':24} {head}")
    for name, each in laps.items():
        worst = [max(getattr(lap, field) for lap in each) for field in _FIGURES]
        ended = "" if all(lap.completed for lap in each) else "  stopped: too far from its path"
        rms_m, max_m, true_rms_m, true_max_m, seconds = worst
        print(
            f"{name:24} {rms_m:7.4f} {max_m:7.4f} {true_rms_m:7.4f} {true_max_m:7.4f} "
            f"{seconds:8.2f}{ended}"
        )
    for name in PATHS:
        shares = [
            closed.rms_m / opened.rms_m if opened.rms_m else inf
            for closed, opened in zip(laps[f"{name} closed"], laps[f"{name} open"], strict=True)
        ]
        print(f"{name}: RMS in closed loop / in open loop: {max(shares):.3f} (wanted <= 0.2)")
    bound_s = shortest_square_s()
    for name, wanted in (("square", 0.85), ("rounded-square", 0.7)):
        slowest_s = max(lap.seconds for lap in laps[f"{name} closed"])
        print(
            f"{name}: {slowest_s:.2f} s, {slowest_s / TODAY_S:.3f} of {TODAY_S} s "
            f"(wanted <= {wanted}), {slowest_s / bound_s:.3f} of the square's bound {bound_s:.2f} s"
        )
    if given.json:
        given.json.write_text(json.dumps({k: [asdict(lap) for lap in v] for k, v in laps.items()}))


_FIGURES = ("rms_m", "max_m", "true_rms_m", "true_max_m", "seconds")


if __name__ == "__main__":
    main()
