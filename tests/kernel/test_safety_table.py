"""The whole safety table on a virtual clock: every cause in every mode, and mutated tables fail."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, pairwise

import pytest

from robotctl.kernel import checks, safety
from robotctl.kernel.modes import Mode
from robotctl.kernel.safety import RULES, Rule, failed_start_condition
from robotctl.kernel.types import ZERO, Cause
from robotctl.testing.kernels import reset
from tests.kernel.fed_kernel import LONGEST_TICKS, MOMENTARY, PROVOKED, FedKernel, in_mode
from tests.support.cases import for_each

IDLE, MOVING = Mode.IDLE, Mode.MOVING
STOP, ERROR = Mode.EMERGENCY_STOP, Mode.ERROR
ALWAYS, DRIVING, NEVER = {IDLE, MOVING}, {MOVING}, set[Mode]()

WANTED: dict[Cause, tuple[Mode, set[Mode]]] = {
    Cause.ESTOP_PRESSED: (STOP, ALWAYS),
    Cause.ESTOP_SILENT: (STOP, DRIVING),
    Cause.BATTERY_LOW: (STOP, DRIVING),
    Cause.TASK_DIED: (ERROR, ALWAYS),
    Cause.RECORDER_FAILED: (ERROR, ALWAYS),
    Cause.UNREACHABLE: (ERROR, ALWAYS),
    Cause.DAEMON_ENDS: (ERROR, NEVER),
    Cause.NOT_ACTIVE: (ERROR, NEVER),
    Cause.ODOMETRY_WRONG: (ERROR, DRIVING),
    Cause.ODOMETRY_LOST: (ERROR, DRIVING),
    Cause.ODOMETRY_CONTRADICTED: (ERROR, DRIVING),
    Cause.SECOND_ODOMETRY: (ERROR, NEVER),
    Cause.FENCE_LEFT: (ERROR, DRIVING),
    Cause.OBSTACLE_NEAR: (ERROR, DRIVING),
    Cause.SCAN_LOST: (ERROR, DRIVING),
    Cause.BUMPER_PRESSED: (ERROR, DRIVING),
    Cause.TILTED: (ERROR, DRIVING),
    Cause.BASE_FAULT: (ERROR, DRIVING),
    Cause.INPUT_LOST: (ERROR, DRIVING),
    Cause.FOREIGN_PUBLISHER: (ERROR, DRIVING),
    Cause.COMMAND_UNHEARD: (ERROR, NEVER),
    Cause.COMMAND_TYPES_MIXED: (ERROR, NEVER),
    Cause.TOPIC_TROUBLE: (ERROR, NEVER),
    Cause.BATTERY_UNKNOWN: (ERROR, DRIVING),
}
"""The table, written a second time in the order of severity: where each cause leads to, from where.

Operators' requests, TRACKING_LOST and what lasts a moment only have tests of their own."""


def test_every_cause_is_provoked_or_has_tests_of_its_own() -> None:
    others = {Cause.OPERATOR_STOP, Cause.OPERATOR_ERROR, Cause.TRACKING_LOST}
    assert set(WANTED) == set(PROVOKED)
    assert set(PROVOKED) | set(MOMENTARY) | others == set(Cause)


def problems(cause: Cause) -> Iterator[str]:
    """Yield what the kernel does about a cause that the table of this test does not want."""
    target, raised_in = WANTED[cause]
    for mode in Mode:
        fed = in_mode(mode)
        if fed.state.mode is not mode:
            yield f"{mode.name} cannot be reached: {fed.replies[-1].message}"
            return
        PROVOKED[cause].begin(fed)
        fed.turn(LONGEST_TICKS)
        wanted = target if mode in raised_in else mode
        if fed.state.mode is not wanted:
            yield f"{mode.name} became {fed.state.mode.name}, not {wanted.name}"
        elif mode in raised_in and fed.state.cause is not cause:
            yield f"{mode.name} ended for {fed.state.cause}"
        if fed.state.mode is not MOVING and fed.state.command != ZERO:
            yield f"a command in {fed.state.mode.name}"
        if mode is IDLE and fed.state.mode is IDLE:
            fed.request(MOVING)
            if fed.replies[-1].ok:
                yield "a motion was begun"
        if mode in raised_in:
            if reset(fed):
                yield f"a reset from {target.name} was granted too early"
            PROVOKED[cause].end(fed)
            fed.turn(60)
            if not reset(fed):
                yield f"a reset was refused although all is well: {fed.replies[-1].message}"


@for_each("cause", PROVOKED)
def test_each_cause_does_in_each_mode_what_the_table_says(cause: Cause) -> None:
    assert list(problems(cause)) == []


@for_each("cause", MOMENTARY)
def test_what_lasts_a_moment_stops_a_motion_and_is_over(cause: Cause) -> None:
    for mode in Mode:
        fed = in_mode(mode)
        MOMENTARY[cause](fed)
        assert fed.state.mode is (ERROR if mode is MOVING else mode)
    fed = in_mode(MOVING)
    MOMENTARY[cause](fed)
    assert fed.state.cause is cause
    fed.turn(2)
    assert reset(fed)


def misordered(first: Cause, second: Cause) -> bool:
    """Return whether another cause than the first is named while both apply."""
    fed: FedKernel = in_mode(IDLE)
    for cause in (second, first):
        PROVOKED[cause].begin(fed)
    fed.turn(LONGEST_TICKS)
    finding = failed_start_condition(fed.state.health, fed.kernel.params, fed.t_ns)
    return finding is None or finding.rule.cause is not first


PAIRS = [
    (first, second)
    for first, second in combinations(WANTED, 2)
    if PROVOKED[first].feed != PROVOKED[second].feed
]


def test_of_neighbouring_causes_that_apply_the_more_severe_one_is_named() -> None:
    neighbours = [pair for pair in pairwise(WANTED) if pair in PAIRS]
    assert [pair for pair in neighbours if misordered(*pair)] == []


@pytest.mark.slow
def test_of_any_two_causes_that_apply_the_more_severe_one_is_named() -> None:
    assert [pair for pair in PAIRS if misordered(*pair)] == []


def use(rules: tuple[Rule, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the kernel decide by this table."""
    raised = tuple(
        tuple(rule for rule in rules if mode in rule.raised_in and rule.check is not checks.healthy)
        for mode in Mode
    )
    monkeypatch.setattr(safety, "RULES", rules)
    monkeypatch.setattr(safety, "RULE_OF", {rule.cause: rule for rule in (*RULES, *rules)})
    monkeypatch.setattr(safety, "_RULES_IN", raised)
    monkeypatch.setattr(safety, "_MEASURED_IN", raised)


def mutants(rule: Rule) -> Iterator[Rule | None]:
    """Yield the rule with one thing changed; None stands for a table without it."""
    yield None
    if rule.raised_in:
        yield replace(rule, action=ERROR if rule.action is STOP else STOP)
        yield replace(rule, raised_in=frozenset())
    else:
        yield replace(rule, raised_in=frozenset({MOVING}))
    if IDLE in rule.raised_in:
        yield replace(rule, raised_in=frozenset({MOVING}))
    else:
        yield replace(rule, raised_in=rule.raised_in | {IDLE})
        if rule.raised_in:  # what is raised in IDLE prevents a release anyway
            yield replace(rule, clear_check=checks.healthy)
    yield replace(rule, check=checks.healthy)


@pytest.mark.parametrize("cause", WANTED)
def test_a_table_with_a_mutated_rule_is_caught(
    cause: Cause, monkeypatch: pytest.MonkeyPatch
) -> None:
    (rule,) = (rule for rule in RULES if rule.cause is cause)
    for mutant in mutants(rule):
        changed = tuple(
            mutant if each is rule else each for each in RULES if each is not rule or mutant
        )
        use(tuple(each for each in changed if each is not None), monkeypatch)
        assert next(problems(cause), ""), mutant


def test_a_table_in_another_order_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    by_cause = {rule.cause: rule for rule in RULES}
    for first, second in [pair for pair in pairwise(WANTED) if pair in PAIRS]:
        swapped = {first: by_cause[second], second: by_cause[first]}
        use(tuple(swapped.get(rule.cause, rule) for rule in RULES), monkeypatch)
        assert misordered(first, second), (first, second)
