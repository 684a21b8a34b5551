"""Each kind of drive gets the commands of the version before, which users have recorded.

`decisions.txt` holds a line for each drive: how many commands there are, and a digest of them. A
change of the rules, the patterns or the plan that is meant changes lines there: run this file as a
script to write them again, and tell users in CHANGELOG.md that their recordings will be `diverged`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from robotctl.kernel.course import PLAIN, Course, Point
from robotctl.kernel.params import KernelParams, TrackingParams, VelocityLimits
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.sim import SimParams
from robotctl.testing.kernels import drive_simulated
from tests.support.cases import for_each

FILE = Path(__file__).with_name("decisions.txt")

LAGGING = SimParams(lag_s=0.04, actuation_linear_factor=1.03, odometry_noise=0.002, seed=7)
TOLD_LAG = KernelParams(tracking=TrackingParams(lag_s=0.04))
SLOW_BRAKES = KernelParams(limits=VelocityLimits(1.0, 9.0, 0.4, 9.0))
FAST = KernelParams(limits=VelocityLimits(1.0, 3.0, 2.0, 9.0))
BENDS: tuple[Point, ...] = ((0.0, 0.0), (0.4, 0.0), (0.6, 0.3), (0.5, 0.3), (-0.1, 0.2))


class Case(NamedTuple):
    """A drive: what is driven, how, with which parameters, and on which base."""

    pattern: Pattern
    course: Course = PLAIN
    laps: int = 1
    params: KernelParams = KernelParams()
    sim: SimParams = SimParams()
    rate_hz: float = 50.0


def _cases() -> Mapping[str, Case]:
    """Return every kind of pattern, and each way to drive one."""
    plain = {kind.value: Case(Pattern(kind, 0.3, 0.4), laps=2) for kind in PatternKind}
    eight = Pattern(PatternKind.FIGURE_EIGHT, 0.2, 0.6)
    square = Pattern(PatternKind.SQUARE, 0.3, 0.4)
    return MappingProxyType(
        {
            **plain,
            "a lagging base, fast": Case(eight, PLAIN, 2, TOLD_LAG, LAGGING, 100.0),
            "larger limits": Case(Pattern(PatternKind.ROUNDED_SQUARE, 0.8, 0.9), params=FAST),
            "laps shorter than braking": Case(
                Pattern(PatternKind.CIRCLE, 0.1, 0.6), PLAIN, 3, SLOW_BRAKES, rate_hz=20.0
            ),
            "a square in reverse": Case(square, Course(reverse=True)),
            "an open loop": Case(eight, Course(open_loop=True)),
            "an arc to the right": Case(Pattern(PatternKind.ARC, 0.3), Course(angle_rad=-4.0)),
            "a long turn to the right": Case(Pattern(PatternKind.TURN), Course(angle_rad=-7.0)),
            "tight corners": Case(Pattern(PatternKind.ROUNDED_SQUARE, 0.5), Course(corner_m=0.03)),
            "waypoints": Case(square, Course(waypoints=BENDS)),
            "waypoints, two laps in reverse": Case(
                square, Course(corner_m=0.05, reverse=True, waypoints=BENDS), 2
            ),
            "waypoints with stops": Case(square, Course(corner_m=0.0, waypoints=BENDS), 2),
        }
    )


CASES = _cases()


def decisions(case: Case) -> str:
    """Drive, and return how many commands there were, with a digest of them to 1e-6."""
    pattern, course, laps, params, sim, rate_hz = case
    driven = drive_simulated(
        pattern, laps=laps, rate_hz=rate_hz, sim=sim, course=course, params=params
    )
    text = "\n".join(f"{each.linear:.6f} {each.angular:.6f}" for each in driven.commands)
    return f"{len(driven.commands)} commands, {sha256(text.encode()).hexdigest()[:16]}"


@cache
def _written() -> Mapping[str, str]:
    lines = (line.partition(": ") for line in FILE.read_text().splitlines())
    return MappingProxyType({name: told for name, _, told in lines})


def test_every_line_belongs_to_a_drive() -> None:
    assert list(_written()) == list(CASES)


@for_each("name", CASES)
def test_a_drive_gets_the_same_commands_as_in_the_last_version(name: str) -> None:
    assert decisions(CASES[name]) == _written()[name]


if __name__ == "__main__":
    FILE.write_text("".join(f"{name}: {decisions(case)}\n" for name, case in CASES.items()))
