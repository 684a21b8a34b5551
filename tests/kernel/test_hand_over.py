"""Hand-over: others may drive in IDLE, and robotctl takes over without two that command."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robotctl.base.errors import ConfigError
from robotctl.config import check_together
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import CommandParams, Foreign, KernelParams, WhenIdle
from robotctl.kernel.types import (
    ZERO,
    Cause,
    CommandPublishersSeen,
    FaultReported,
    ForeignCommandHeard,
    PublishTwist,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.testing.kernels import Bench, ready, start, stopped_by

QUIET = replace(KernelParams(), command=CommandParams(when_idle=WhenIdle.SILENT))


def yielding() -> Bench:
    command = CommandParams(when_idle=WhenIdle.SILENT, foreign=Foreign.YIELD)
    bench = ready(replace(KernelParams(), command=command))
    bench.run(60)
    return bench


def sent(bench: Bench) -> bool:
    return PublishTwist(ZERO) in bench.tick()


def test_in_idle_zeros_are_sent_for_a_second_and_nothing_then() -> None:
    bench = Bench(QUIET)
    assert sent(bench)
    begin_ns = bench.t_ns
    while sent(bench):
        assert not bench.state.silent
    assert bench.t_ns - begin_ns == NS_PER_S
    assert bench.state.silent
    bench.run(100)
    assert not sent(bench)


@pytest.mark.parametrize("mode", [Mode.ERROR, Mode.EMERGENCY_STOP])
def test_error_and_emergency_stop_always_send_zeros(mode: Mode) -> None:
    bench = ready(QUIET)
    bench.run(60)
    bench.request(mode)
    assert not bench.state.silent
    for _ in range(200):
        assert sent(bench)


def test_a_fault_that_the_daemon_reports_ends_the_silence() -> None:
    bench = ready(QUIET)
    bench.run(60)
    bench.give(FaultReported(bench.t_ns, Cause.DAEMON_ENDS, "the daemon is stopping"))
    assert sent(bench)


def test_a_motion_ends_the_silence_and_a_second_after_it_comes_again() -> None:
    bench = ready(QUIET)
    bench.run(60)
    assert not start(bench)
    assert not bench.state.silent
    bench.run(3)
    bench.request(Mode.IDLE)
    bench.run(10)
    assert bench.state.mode is Mode.IDLE
    assert not bench.state.silent
    bench.run(60)
    assert bench.state.silent


def test_yield_lets_others_drive_in_idle_and_starts_once_they_are_quiet() -> None:
    bench = yielding()
    bench.give(CommandPublishersSeen(bench.t_ns, ("/nav2",)))
    bench.give(ForeignCommandHeard(bench.t_ns, "/nav2"))
    assert bench.state.mode is Mode.IDLE
    assert "/nav2 also published a velocity command" in start(bench)
    bench.run(51)
    assert not start(bench)
    bench.give(ForeignCommandHeard(bench.t_ns, "/nav2"))
    assert stopped_by(bench, Cause.FOREIGN_PUBLISHER, Mode.ERROR)


def test_warn_lets_the_motion_go_on() -> None:
    bench = ready(replace(KernelParams(), command=CommandParams(foreign=Foreign.WARN)))
    bench.give(CommandPublishersSeen(bench.t_ns, ("/nav2",)))
    assert not start(bench)
    bench.give(ForeignCommandHeard(bench.t_ns, "/nav2"))
    bench.run(1)
    assert bench.state.mode is Mode.MOVING


def test_yield_without_silence_is_refused() -> None:
    with pytest.raises(ConfigError, match="when_idle silent with it"):
        check_together(KernelParams(command=CommandParams(foreign=Foreign.YIELD)))
