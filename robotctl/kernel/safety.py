"""The safety table.

A rule whose `check` finds something wrong refuses the start of motion. In the modes of `raised_in`
it also changes the mode to `action`. The most severe rule that applies decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from robotctl.kernel import checks
from robotctl.kernel.checks import Check
from robotctl.kernel.modes import Mode, Trigger
from robotctl.kernel.params import KernelParams
from robotctl.kernel.state import Health
from robotctl.kernel.types import RESETTING, Cause, Remedy


@dataclass(frozen=True, slots=True)
class Rule:
    """A safety rule: while `check` returns a sentence, `cause` applies and motion cannot start.

    It changes the modes in `raised_in` to `action`, and has cleared when `clear_check` returns "".
    """

    cause: Cause
    action: Mode
    raised_in: frozenset[Mode]
    check: Check
    clear_check: Check
    remedy: Remedy


_MOVING = frozenset({Mode.MOVING})
_ALWAYS = frozenset({Mode.IDLE, Mode.MOVING})
_NEVER: frozenset[Mode] = frozenset()


def _rule(
    cause: Cause,
    raised_in: frozenset[Mode],
    check: Check,
    remedy: Remedy,
    action: Mode = Mode.ERROR,
    clear_check: Check | None = None,
) -> Rule:
    return Rule(cause, action, raised_in, check, clear_check or check, remedy)


_REPORTED: tuple[Rule, ...] = tuple(
    _rule(cause, raised_in, checks.reported(cause), remedy)
    for cause, raised_in, remedy in (
        (Cause.TASK_DIED, _ALWAYS, Remedy.READ_LOG_AND_RESTART),
        (Cause.RECORDER_FAILED, _ALWAYS, Remedy.RESTART),
        (Cause.UNREACHABLE, _ALWAYS, Remedy.RESTORE_SOCKET_FOLDER),
        (Cause.DAEMON_ENDS, _NEVER, Remedy.START_DAEMON),
    )
)
"""Rules for the failures that the daemon reports."""

_STOP = Mode.EMERGENCY_STOP
_TROUBLE = checks.reported(Cause.TOPIC_TROUBLE)

RULES: tuple[Rule, ...] = (
    _rule(Cause.OPERATOR_STOP, _NEVER, checks.healthy, Remedy.RELEASE_STOP, _STOP),
    _rule(Cause.ESTOP_PRESSED, _ALWAYS, checks.estop_pressed, Remedy.RELEASE_BUTTON, _STOP),
    _rule(Cause.ESTOP_SILENT, _MOVING, checks.estop_silent, Remedy.CHECK_INPUT, _STOP),
    _rule(
        Cause.BATTERY_LOW,
        _MOVING,
        checks.battery_at_stop,
        Remedy.CHARGE_BATTERY,
        _STOP,
        checks.battery_before_clear,
    ),
    *_REPORTED,
    _rule(Cause.NOT_ACTIVE, _NEVER, checks.not_active, Remedy.ACTIVATE),
    _rule(Cause.LOOP_STALLED, _MOVING, checks.healthy, Remedy.FREE_PROCESSOR),
    _rule(Cause.TICK_OVERRUN, _MOVING, checks.tick_overrun, Remedy.FREE_PROCESSOR_OR_LOWER_RATE),
    _rule(Cause.ODOMETRY_WRONG, _MOVING, checks.odometry_wrong, Remedy.CHECK_ODOMETRY_SOURCE),
    _rule(Cause.ODOMETRY_LOST, _MOVING, checks.odometry_lost, Remedy.CHECK_ODOMETRY_IS_PUBLISHED),
    _rule(
        Cause.ODOMETRY_CONTRADICTED,
        _MOVING,
        checks.odometry_contradicted,
        Remedy.STOP_ONE_ODOMETRY_PUBLISHER,
    ),
    _rule(
        Cause.SECOND_ODOMETRY,
        _NEVER,
        checks.second_odometry,
        Remedy.STOP_ONE_ODOMETRY_PUBLISHER,
    ),
    _rule(Cause.FENCE_LEFT, _MOVING, checks.fence_left, Remedy.BRING_BACK),
    _rule(Cause.OBSTACLE_NEAR, _MOVING, checks.obstacle_near, Remedy.CLEAR_PATH),
    _rule(Cause.SCAN_LOST, _MOVING, checks.scan_lost, Remedy.CHECK_SCAN),
    _rule(Cause.BUMPER_PRESSED, _MOVING, checks.bumper_pressed, Remedy.FREE_ROBOT),
    _rule(Cause.TILTED, _MOVING, checks.tilted, Remedy.FREE_ROBOT),
    _rule(Cause.BASE_FAULT, _MOVING, checks.base_fault, Remedy.CHECK_BASE),
    _rule(Cause.INPUT_LOST, _MOVING, checks.input_lost, Remedy.CHECK_INPUT),
    _rule(Cause.TRACKING_LOST, _MOVING, checks.tracking_lost, Remedy.CHECK_WHEELS),
    _rule(
        Cause.FOREIGN_PUBLISHER, _MOVING, checks.foreign_publisher, Remedy.STOP_COMMAND_PUBLISHER
    ),
    _rule(Cause.COMMAND_UNHEARD, _NEVER, checks.command_unheard, Remedy.START_BASE),
    _rule(Cause.COMMAND_TYPES_MIXED, _NEVER, checks.command_types_mixed, Remedy.SET_COMMAND_TYPE),
    _rule(Cause.TOPIC_TROUBLE, _NEVER, _TROUBLE, Remedy.CHECK_TOPIC),
    _rule(Cause.BATTERY_UNKNOWN, _MOVING, checks.battery_unknown, Remedy.CHECK_BATTERY_TOPIC),
    _rule(Cause.OPERATOR_ERROR, _NEVER, checks.healthy, Remedy.CLEAR_ERROR),
)
"""Every cause, the most severe first; the default action is ERROR."""

RULE_OF: Mapping[Cause, Rule] = MappingProxyType({rule.cause: rule for rule in RULES})

FAULT_TRIGGERS: Mapping[Mode, Trigger] = MappingProxyType(
    {Mode.ERROR: Trigger.FAULT_ERROR, Mode.EMERGENCY_STOP: Trigger.FAULT_EMERGENCY_STOP}
)


@dataclass(frozen=True, slots=True)
class Finding:
    """A rule that applies now, with the sentence of its check."""

    rule: Rule
    detail: str


def _rules_in(rules: Iterable[Rule]) -> tuple[tuple[Rule, ...], ...]:
    """Return, for each mode, the rules that can change it."""
    rules = [rule for rule in rules if rule.check is not checks.healthy]
    return tuple(tuple(rule for rule in rules if mode in rule.raised_in) for mode in Mode)


_RULES_IN = _rules_in(RULES)
_MEASURED_IN = _rules_in(rule for rule in RULES if rule not in _REPORTED)
"""The rules that can apply while the daemon reports no failure."""

_OF_INPUTS = (
    *(Cause.ESTOP_PRESSED, Cause.ESTOP_SILENT, Cause.OBSTACLE_NEAR, Cause.SCAN_LOST),
    *(Cause.BUMPER_PRESSED, Cause.TILTED, Cause.BASE_FAULT, Cause.INPUT_LOST),
)
_FEWEST_IN = _rules_in(
    rule for rule in RULES if rule not in _REPORTED and rule.cause not in _OF_INPUTS
)
"""The rules of `_MEASURED_IN` that can apply without safety inputs and scans."""


def raised(mode: Mode, health: Health, params: KernelParams, t_ns: int) -> Finding | None:
    """Return the most severe finding that changes `mode` now, None if there is none."""
    if health.reported:
        rules = _RULES_IN
    elif health.inputs or health.scan is not None or checks.is_any_required(params):
        rules = _MEASURED_IN
    else:
        rules = _FEWEST_IN
    return _first_that_applies(rules[mode], health, params, t_ns)


def failed_start_condition(health: Health, params: KernelParams, t_ns: int) -> Finding | None:
    """Return the most severe finding that forbids the start of a motion, None if there is none."""
    return _first_that_applies(RULES, health, params, t_ns)


def start_conditions(
    health: Health, params: KernelParams, t_ns: int
) -> tuple[tuple[Rule, str], ...]:
    """Return each rule that can forbid the start of a motion, with the result of its check."""
    return tuple(
        (rule, rule.check(health, params, t_ns))
        for rule in RULES
        if rule.check is not checks.healthy
    )


def _first_that_applies(
    rules: tuple[Rule, ...], health: Health, params: KernelParams, t_ns: int
) -> Finding | None:
    for rule in rules:
        detail = rule.check(health, params, t_ns)
        if detail:
            return Finding(rule, detail)
    return None


def remedies_for(cause: Cause | None) -> tuple[Remedy, ...]:
    """Return the operator's remedies for the cause of a mode, () if there is no cause."""
    return () if cause is None else (RULE_OF[cause].remedy,)


def remedies_to_move(cause: Cause) -> tuple[Remedy, ...]:
    """Return what the operator must do, in order, to move again after a stop by `cause`."""
    remedy = RULE_OF[cause].remedy
    return (remedy,) if remedy in RESETTING else (remedy, Remedy.RESET)


def uncleared(cause: Cause, health: Health, params: KernelParams, t_ns: int) -> Finding | None:
    """Return the rule of `cause` and why it has not cleared yet, or None if it has."""
    rule = RULE_OF[cause]
    detail = rule.clear_check(health, params, t_ns)
    return Finding(rule, detail) if detail else None
