"""Proposes limits and gains for a base from its measured properties."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import degrees, pi, sqrt
from typing import Final

from robotctl.commission.measure import Measured, Turned
from robotctl.kernel.params import KernelParams

STEERED_DELAY_S: Final = 0.2
"""Up to this delay, the default gains are proposed, and beyond it smaller ones."""

STOP_WITHIN_M: Final = 0.3
"""The distance within which the base stops from the proposed speed."""

STOP_WITHIN_RAD: Final = pi / 4.0
"""The angle within which the base stops from the proposed turn rate."""

ODOMETRY_PERIODS: Final = 10
LARGEST_GAPS: Final = 3
MIN_TIMEOUT_S: Final = 0.5


@dataclass(frozen=True, slots=True)
class Proposal:
    """A value for a key of the configuration, and why it is proposed."""

    key: str
    value: float
    why: str


def proposals(base: Measured, present: KernelParams) -> list[Proposal]:
    """Return proposed values for the base; limits and gains do not exceed those in `present`."""
    follow_s = base.command_delay_s
    lag_s = _rounded(min(max(follow_s - (base.odometry_delay_s or 0.0), 0.0), 0.5))
    steer_s = max(follow_s, base.turn.command_delay_s if base.turn else 0.0)
    share, steered = _share(follow_s), _share(steer_s)
    gains, defaults = present.tracking, KernelParams().tracking
    period_s = ODOMETRY_PERIODS / base.odometry_hz
    timeout_s = max(period_s, LARGEST_GAPS * base.odometry_gap_s, MIN_TIMEOUT_S)
    return [
        Proposal(
            "limits.linear_mps",
            _rounded(max(min(present.limits.linear_mps, _speed_mps(base, present)), 0.01)),
            f"at most so fast that it stops within {STOP_WITHIN_M:g} m",
        ),
        *_turning(base.turn, present),
        Proposal("tracking.lag_s", lag_s, f"the base follows a command {lag_s:g} s later"),
        Proposal(
            "tracking.k_x", _rounded(min(gains.k_x, defaults.k_x * share)), _allowed_by(follow_s)
        ),
        Proposal(
            "tracking.k_y",
            _rounded(min(gains.k_y, defaults.k_y * steered**2)),
            _allowed_by(steer_s),
        ),
        Proposal(
            "tracking.k_theta",
            _rounded(min(gains.k_theta, defaults.k_theta * steered)),
            _allowed_by(steer_s),
        ),
        Proposal(
            "odometry.timeout_s",
            _rounded(min(timeout_s, 10.0)),
            f"{ODOMETRY_PERIODS} periods, {LARGEST_GAPS} of the largest gaps, "
            f"and {MIN_TIMEOUT_S:g} s at least",
        ),
    ]


def configuration(settings: Mapping[str, object], proposed: list[Proposal]) -> dict[str, object]:
    """Return a copy of `settings` with the proposed values."""
    return {**settings, **{each.key: each.value for each in proposed}}


def _turning(turn: Turned | None, present: KernelParams) -> list[Proposal]:
    """Return the proposed limit of the turn rate; [] for a base that cannot turn on the spot."""
    if turn is None:
        return []
    limits = present.limits
    reaction_s = turn.stopping_rad / turn.reached_rps
    rate = _stopping_within(STOP_WITHIN_RAD, reaction_s, limits.angular_accel_rps2)
    return [
        Proposal(
            "limits.angular_rps",
            _rounded(max(min(limits.angular_rps, rate), 0.01)),
            f"at most so fast that it stops within {degrees(STOP_WITHIN_RAD):.0f} degrees",
        )
    ]


def _share(delay_s: float) -> float:
    return min(1.0, STEERED_DELAY_S / delay_s) if delay_s else 1.0


def _allowed_by(delay_s: float) -> str:
    if _share(delay_s) < 1.0:
        return f"{delay_s:.2f} s of delay allow no more"
    return "that of the default"


def _speed_mps(base: Measured, present: KernelParams) -> float:
    reaction_s = base.stopping_m / base.reached_mps
    return _stopping_within(STOP_WITHIN_M, reaction_s, present.limits.linear_accel_mps2)


def _stopping_within(way: float, reaction_s: float, braking: float) -> float:
    """Return the speed v with a stopping way of v * reaction_s + v^2 / (2 * braking) = way."""
    return braking * (sqrt(reaction_s**2 + 2.0 * way / braking) - reaction_s)


def _rounded(value: float) -> float:
    """Round to two decimals, so that the value is readable."""
    return round(value, 2)


def measured_lines(base: Measured) -> Iterator[str]:
    """Yield a line for each measured property."""
    delay_s = base.odometry_delay_s
    came = "its clock is another" if delay_s is None else f"{delay_s * 1e3:.1f} ms after its stamp"
    yield (
        f"odometry       {base.odometry_hz:.1f} Hz, {base.odometry_gap_s * 1e3:.0f} ms apart at "
        f"most, {came}"
    )
    yield f"speed          {base.reached_mps:.3f} m/s where {base.commanded_mps:.3f} was commanded"
    yield f"command delay  {base.command_delay_s:.2f} s until odometry follows"
    yield f"stopping       {base.stopping_m:.3f} m and {base.stopping_s:.2f} s after a zero"
    if base.base_timeout_s is None:
        yield f"base timeout   none within {base.quiet_s:g} s"
    else:
        yield f"base timeout   {base.base_timeout_s:.2f} s after the last command"
    turn = base.turn
    if turn is None:
        yield "turning        not on its place"
    else:
        rates = f"{turn.reached_rps:.3f} rad/s where {turn.commanded_rps:.3f} was commanded"
        yield f"turning        {rates}"
        yield f"  delay        {turn.command_delay_s:.2f} s until odometry follows"
        yield f"  stopping     {turn.stopping_rad:.3f} rad and {turn.stopping_s:.2f} s after a zero"


def warnings(base: Measured) -> Iterator[str]:
    """Yield a sentence for each property that is dangerous, or makes a measured value doubtful."""
    if base.base_timeout_s is None:
        yield (
            f"the base went on for {base.quiet_s:g} s without a command: if robotctl is killed, "
            "only its own emergency stop stops it"
        )
    if base.odometry_delay_s is None:
        yield (
            f"odometry is stamped by a clock that differs by {base.clock_offset_s:.1f} s: "
            "its delay is unknown, and part of the command delay"
        )
    share = base.reached_mps / base.commanded_mps
    if abs(share - 1.0) > SPEED_TOLERANCE:
        yield f"the base drove {share:.0%} of the commanded speed: see its wheel parameters"
    if base.turn is None:
        yield (
            "the base did not turn on its place: limits.angular_rps is as it was, and patterns "
            "with corners need a base that can"
        )
    elif abs(base.turn.reached_rps / base.turn.commanded_rps - 1.0) > SPEED_TOLERANCE:
        share = base.turn.reached_rps / base.turn.commanded_rps
        yield f"the base turned at {share:.0%} of the commanded rate: see its wheel separation"


SPEED_TOLERANCE = 0.1


def file_lines(
    robot: str, base: Measured, settings: Mapping[str, object], proposed: list[Proposal]
) -> Iterator[str]:
    """Yield the lines of a configuration file with the settings and the proposals."""
    yield f"# Proposed by robotctl commission for robot {robot}, from motions at"
    yield f"# {base.commanded_mps:g} m/s. Read it before you use it."
    yield "#"
    for line in (*measured_lines(base), *(f"warning: {text}" for text in warnings(base))):
        yield f"# {line}"
    yield ""
    for each in proposed:
        yield f"{each.key}: {each.value:g}  # {each.why}"
    keys = {each.key for each in proposed}
    for key, value in settings.items():
        if key not in keys:
            yield f"{key}: {json.dumps(value)}"
