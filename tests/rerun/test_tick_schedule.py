"""Ticks come at multiples of their period, a little late: a removed one delays all others."""

from __future__ import annotations

from collections.abc import Iterable
from random import Random

import pytest

from robotctl.kernel.types import LoopStalled, Tick
from robotctl.rerun.tick_schedule import MissingTicks, TickSchedule

PERIOD_NS = 20_000_000


def honest(seconds: float, busy_s: tuple[float, float] = (0.0, 0.0)) -> list[Tick]:
    """Return the ticks of a loop at 50 Hz that lags by up to 90 ms while it is busy."""
    random, ticks, missed = Random(1), [Tick(0)], 0
    for due_ns in range(PERIOD_NS, round(seconds * 1e9), PERIOD_NS):
        is_busy = busy_s[0] <= due_ns * 1e-9 < busy_s[1]
        t_ns = due_ns + random.randrange(15_000_000, 90_000_000) * is_busy
        t_ns += random.randrange(2_000_000)
        if t_ns < ticks[-1].t_ns:
            missed += 1
            continue
        ticks.append(Tick(t_ns, missed))
        missed = 0
    return ticks


def missing(ticks: Iterable[Tick]) -> list[MissingTicks]:
    schedule = TickSchedule()
    schedule.begin(50.0)
    for seq, tick in enumerate(ticks):
        schedule.step(tick, seq)
    schedule.stop()
    return schedule.missing


@pytest.mark.parametrize("busy_s", [(0.0, 0.0), (0.0, 2.0), (4.0, 8.0)])
def test_a_busy_loop_lacks_no_tick(busy_s: tuple[float, float]) -> None:
    assert missing(honest(12.0, busy_s)) == []


def test_ticks_that_are_counted_as_missed_are_not_missing() -> None:
    ticks = honest(6.0)
    ticks[100:111] = [Tick(ticks[110].t_ns, 10)]
    assert missing(ticks) == []


@pytest.mark.parametrize("count", [1, 10])
def test_removed_ticks_are_missing_and_counted(count: int) -> None:
    ticks = honest(6.0)
    del ticks[100 : 100 + count]
    (found,) = missing(ticks)
    assert found.ticks == count
    assert 100 <= found.seq <= 151  # in the next second


def test_what_follows_a_gap_has_a_schedule_of_its_own() -> None:
    schedule = TickSchedule()
    schedule.begin(50.0)
    for late_ns in (0, 7 * PERIOD_NS // 2):
        for tick in honest(4.0):
            schedule.step(Tick(tick.t_ns + late_ns, tick.missed), 1)
        schedule.step(LoopStalled(0, 0.2, 1, 0, ""), 2)
        schedule.stop()
    assert schedule.missing == []
