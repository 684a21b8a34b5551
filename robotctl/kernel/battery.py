"""The battery level, from gauges that count to 1 or to 100."""

from __future__ import annotations

from typing import TypeGuard

from robotctl.kernel.params import BatteryScale

FULLEST_LEVEL = 1.05
"""The highest valid level: gauges overshoot. A higher value is in percent, or wrong."""


def counts_in_percent(raw: float, before: bool, scale: BatteryScale) -> bool:
    """Return whether the gauge that reports `raw` counts to 100; `before` is the last answer."""
    if scale is BatteryScale.AUTO:
        return before or FULLEST_LEVEL < raw <= 100.0 * FULLEST_LEVEL
    return scale is BatteryScale.PERCENT


def level_of(raw: float, in_percent: bool) -> float:
    """Return the level: 0..1 for a gauge that works."""
    return raw / 100.0 if in_percent else raw


def full_level(scale: BatteryScale) -> float:
    """Return the value that a gauge of this scale reports when the battery is full."""
    return 100.0 if scale is BatteryScale.PERCENT else 1.0


def is_level(level: float | None) -> TypeGuard[float]:
    """Return whether this is a possible battery level; None and NaN are not."""
    return level is not None and 0.0 <= level <= FULLEST_LEVEL
