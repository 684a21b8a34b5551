"""How full the battery is, whatever its gauge calls full."""

from __future__ import annotations

from typing import TypeGuard

from robotctl.kernel.params import BatteryScale

FULLEST_LEVEL = 1.05
"""Gauges overshoot; a level above this one is of a gauge that counts in percent, or broken."""


def counts_in_percent(raw: float, before: bool, scale: BatteryScale) -> bool:
    """Say whether the gauge that reports `raw` counts to 100; `before` is what was said last."""
    if scale is BatteryScale.AUTO:
        return before or FULLEST_LEVEL < raw <= 100.0 * FULLEST_LEVEL
    return scale is BatteryScale.PERCENT


def level_of(raw: float, in_percent: bool) -> float:
    """Return the level, 0..1 where the gauge is right."""
    return raw / 100.0 if in_percent else raw


def full_level(scale: BatteryScale) -> float:
    """Return what a gauge of this scale reports of a full battery."""
    return 100.0 if scale is BatteryScale.PERCENT else 1.0


def is_level(level: float | None) -> TypeGuard[float]:
    """Say whether this is how full a battery can be; NaN is not."""
    return level is not None and 0.0 <= level <= FULLEST_LEVEL
