"""Limits and gains that fit a base, from what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Final

from robotctl.commission.measure import Measured
from robotctl.kernel.params import KernelParams

STEERED_DELAY_S: Final = 0.2
"""The delay up to which the default gains steer; beyond it, gain times delay is kept."""

STOP_WITHIN_M: Final = 0.3
"""The distance within which the proposed speed stops."""

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
    """Return the values that fit this base; within the ranges that the keys allow."""
    follow_s = base.command_delay_s
    lag_s = _rounded(min(max(follow_s - (base.odometry_delay_s or 0.0), 0.0), 0.5))
    share = min(1.0, STEERED_DELAY_S / follow_s) if follow_s else 1.0
    gains, defaults = present.tracking, KernelParams().tracking
    slower = f"{follow_s:.2f} s of delay allow no more" if share < 1.0 else "that of the default"
    period_s = ODOMETRY_PERIODS / base.odometry_hz
    timeout_s = max(period_s, LARGEST_GAPS * base.odometry_gap_s, MIN_TIMEOUT_S)
    return [
        Proposal(
            "limits.linear_mps",
            _rounded(max(min(present.limits.linear_mps, _speed_mps(base, present)), 0.01)),
            f"at most so fast that it stops within {STOP_WITHIN_M:g} m",
        ),
        Proposal("tracking.lag_s", lag_s, f"the base follows a command {lag_s:g} s later"),
        Proposal("tracking.k_x", _rounded(min(gains.k_x, defaults.k_x * share)), slower),
        Proposal("tracking.k_y", _rounded(min(gains.k_y, defaults.k_y * share**2)), slower),
        Proposal(
            "tracking.k_theta", _rounded(min(gains.k_theta, defaults.k_theta * share)), slower
        ),
        Proposal(
            "odometry.timeout_s",
            _rounded(min(timeout_s, 10.0)),
            f"{ODOMETRY_PERIODS} periods, {LARGEST_GAPS} of the largest gaps, "
            f"and {MIN_TIMEOUT_S:g} s at least",
        ),
    ]


def configuration(settings: Mapping[str, object], proposed: list[Proposal]) -> dict[str, object]:
    """Return settings with the proposed values in place of theirs."""
    return {**settings, **{each.key: each.value for each in proposed}}


def _speed_mps(base: Measured, present: KernelParams) -> float:
    """Return the speed v with v * reaction + v^2 / (2 * braking) = STOP_WITHIN_M."""
    reaction_s = base.stopping_m / base.reached_mps
    braking = present.limits.linear_accel_mps2
    return braking * (sqrt(reaction_s**2 + 2.0 * STOP_WITHIN_M / braking) - reaction_s)


def _rounded(value: float) -> float:
    """Round to two digits after the point, so that the value can be read."""
    return round(value, 2)
