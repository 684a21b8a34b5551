"""Gauges that count to 1 and gauges that count to 100."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotctl.kernel.modes import Mode
from robotctl.kernel.params import BatteryParams, BatteryScale, KernelParams
from robotctl.kernel.remedies import Remedy
from robotctl.kernel.types import Cause
from robotctl.testing.kernels import Bench, ready, start, stopped_by


def bench_of(scale: BatteryScale) -> Bench:
    return ready(replace(KernelParams(), battery=BatteryParams(scale=scale)))


def test_a_level_beyond_the_scale_is_refused_as_it_came_with_its_remedy() -> None:
    bench = bench_of(BatteryScale.ONE)
    bench.battery(87.4)
    assert "the battery reports 87.4, not 0 to 1" in start(bench)
    assert bench.replies[-1].remedies == (Remedy.CHECK_BATTERY_TOPIC,)


@pytest.mark.parametrize("scale", [BatteryScale.PERCENT, BatteryScale.AUTO])
def test_a_gauge_that_counts_in_percent_is_understood(scale: BatteryScale) -> None:
    bench = bench_of(scale)
    bench.battery(87.4)
    assert bench.state.health.battery_level == 87.4 / 100.0
    assert not start(bench)
    bench.battery(14.0)
    assert stopped_by(bench, Cause.BATTERY_LOW, Mode.EMERGENCY_STOP)


def test_auto_stays_with_percent_once_it_has_seen_it() -> None:
    bench = bench_of(BatteryScale.AUTO)
    bench.battery(87.4)
    bench.battery(1.0)
    assert bench.state.health.battery_level == 0.01


@pytest.mark.parametrize("broken", [float("inf"), float("nan"), 1e9, -5.0])
def test_one_broken_sample_does_not_change_the_scale(broken: float) -> None:
    bench = bench_of(BatteryScale.AUTO)
    bench.battery(broken)
    bench.battery(0.8)
    assert bench.state.health.battery_level == 0.8


def test_a_level_beyond_100_percent_is_unknown() -> None:
    bench = bench_of(BatteryScale.PERCENT)
    bench.battery(874.0)
    assert "the battery reports 874, not 0 to 100" in start(bench)
