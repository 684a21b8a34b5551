"""The start conditions in words."""

from __future__ import annotations

from robotctl.ipc.advice import condition_of
from robotctl.kernel.safety import start_conditions
from robotctl.kernel.types import Cause
from robotctl.testing.kernels import ready


def test_each_condition_has_words_of_its_own() -> None:
    bench = ready()
    causes = [
        rule.cause
        for rule, _ in start_conditions(bench.state.health, bench.kernel.params, bench.t_ns)
    ]
    assert len({condition_of(cause) for cause in causes}) == len(causes)
    assert all(condition_of(cause) for cause in Cause)


def test_the_conditions_are_those_that_guard_a_start() -> None:
    bench = ready()
    conditions = start_conditions(bench.state.health, bench.kernel.params, bench.t_ns)
    assert not any(problem for _, problem in conditions)
    bench.battery(0.1)
    conditions = start_conditions(bench.state.health, bench.kernel.params, bench.t_ns)
    assert [rule.cause for rule, problem in conditions if problem] == [Cause.BATTERY_LOW]
