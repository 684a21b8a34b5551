"""What may stop the robot: cause -> action -> clear condition, ordered by severity.

A rule that is present refuses the start of motion; in one of its `raised_in` modes it raises its
action, and further up takes precedence. It has cleared when `hindrance` finds nothing anymore.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isfinite
from types import MappingProxyType

from robotctl.kernel.battery import is_level
from robotctl.kernel.health import Health
from robotctl.kernel.modes import Mode, Trigger
from robotctl.kernel.params import KernelParams
from robotctl.kernel.remedies import RESETTING, Remedy
from robotctl.kernel.types import Cause
from robotctl.kernel.units import NS_PER_S

FOREIGN_COMMAND_S = 1.0
"""How long a command of another node hinders motion: its publisher may send only now and then."""


def _age_s(then_ns: int, t_ns: int) -> float:
    """Return how long ago that was; what lies in the future is as stale as the past."""
    return abs(t_ns - then_ns) / NS_PER_S


Check = Callable[[Health, KernelParams, int], str]
"""(health, params, now in steady ns) -> what is wrong, "" if nothing."""


def _healthy(health: Health, params: KernelParams, t_ns: int) -> str:
    return ""


def _reported(cause: Cause) -> Check:
    def check(health: Health, params: KernelParams, t_ns: int) -> str:
        for reported, detail in health.reported:
            if reported is cause:
                return detail or cause.value
        return ""

    return check


def _battery_at_stop(health: Health, params: KernelParams, t_ns: int) -> str:
    level, stop_level = health.battery_level, params.battery.stop_level
    if not params.battery.topic or not is_level(level) or level > stop_level:
        return ""
    return f"the battery is at {_shown(level)}, at or below {stop_level:.0%}"


def _battery_before_clear(health: Health, params: KernelParams, t_ns: int) -> str:
    level, clear_level = health.battery_level, params.battery.clear_level
    if not params.battery.topic or (is_level(level) and level >= clear_level):
        return ""
    return f"the battery is at {_shown(level)}, not yet at {clear_level:.0%}"


def _shown(level: float | None) -> str:
    return f"{level:.0%}" if is_level(level) else "an unknown level"


def _battery_unknown(health: Health, params: KernelParams, t_ns: int) -> str:
    if not params.battery.topic:
        return ""
    if health.battery_level is None:
        return f"no battery level was received on {params.battery.topic} yet"
    if not is_level(health.battery_level):
        full, reported = (100, 100.0) if health.battery_in_percent else (1, 1.0)
        return f"the battery reports {health.battery_level * reported:g}, not 0 to {full}"
    age_s = _age_s(health.battery_t_ns, t_ns)
    return f"no battery level for {age_s:.1f} s" if age_s > params.battery.timeout_s else ""


def _odometry_wrong(health: Health, params: KernelParams, t_ns: int) -> str:
    if not health.odometry_fault or not _odometry_lost(health, params, t_ns):
        return ""
    return health.odometry_fault


def _odometry_lost(health: Health, params: KernelParams, t_ns: int) -> str:
    if health.odometry is None:
        return f"no odometry was received on {params.odometry.topic} yet"
    age_s = _age_s(health.odometry_t_ns, t_ns)
    if age_s <= params.odometry.timeout_s:
        return ""
    return f"no odometry on {params.odometry.topic} for {age_s:.2f} s"


def _odometry_contradicted(health: Health, params: KernelParams, t_ns: int) -> str:
    second, limits = health.odometry_sources.second, params.odometry
    if second is None or _age_s(second.t_ns, t_ns) > limits.timeout_s:
        return ""
    if second.distance_m <= limits.max_jump_m and second.angle_rad <= limits.max_jump_rad:
        return ""
    apart = f"{second.distance_m:.2f} m and {second.angle_rad:.2f} rad apart"
    if not isfinite(second.distance_m + second.angle_rad):
        apart = "not both finite"
    return f"{_two_sources(health)}, and they are {apart}"


def _second_odometry(health: Health, params: KernelParams, t_ns: int) -> str:
    second = health.odometry_sources.second
    if second is None or _age_s(second.t_ns, t_ns) > params.odometry.timeout_s:
        return ""
    return _two_sources(health)


def _two_sources(health: Health) -> str:
    sources = health.odometry_sources
    assert sources.second is not None
    names = sources.name_of(sources.followed), sources.name_of(sources.second.source)
    return f"odometry comes from two publishers, {names[0]} and {names[1]}"


def _tracking_lost(health: Health, params: KernelParams, t_ns: int) -> str:
    error_m, limit_m = health.path_error_m, params.tracking.max_error_m
    if error_m <= limit_m:
        return ""
    if error_m == inf:
        return "the robot is further from where it should be than the pattern is large"
    return f"the robot is {error_m:.2f} m from where it should be, more than {limit_m:g} m"


def _foreign_publisher(health: Health, params: KernelParams, t_ns: int) -> str:
    if health.foreign_publishers:
        names = ", ".join(health.foreign_publishers)
        verb = "publishes" if len(health.foreign_publishers) == 1 else "publish"
        return f"{names} also {verb} velocity commands"
    topic = health.command_topic
    if topic.foreign_t_ns is None or _age_s(topic.foreign_t_ns, t_ns) > FOREIGN_COMMAND_S:
        return ""
    return f"{topic.foreign_by} also published a velocity command"


def _command_unheard(health: Health, params: KernelParams, t_ns: int) -> str:
    topic = health.command_topic
    if topic.listeners is None or topic.listeners > 0:
        return ""
    if not topic.other_types:
        return f"no node subscribes to {params.command.topic}"
    types = ", ".join(topic.other_types)
    return f"the robot takes {types} on {params.command.topic}, not geometry_msgs/msg/Twist"


def _tick_overrun(health: Health, params: KernelParams, t_ns: int) -> str:
    gap_s = health.tick_gap_s
    if gap_s < 0.0:
        return f"the steady clock went back by {-gap_s:.2f} s"
    return f"no control tick for {gap_s:.2f} s" if gap_s > 0.0 else ""


@dataclass(frozen=True, slots=True)
class Rule:
    """One cause: what it leads to and where, how it is recognised, and what the operator can do."""

    cause: Cause
    action: Mode
    raised_in: frozenset[Mode]
    present: Check
    hindrance: Check
    remedy: Remedy


_MOVING = frozenset({Mode.MOVING})
_ALWAYS = frozenset({Mode.IDLE, Mode.MOVING})
_NEVER: frozenset[Mode] = frozenset()


def _rule(
    cause: Cause, action: Mode, raised_in: frozenset[Mode], check: Check, remedy: Remedy
) -> Rule:
    return Rule(cause, action, raised_in, check, check, remedy)


_REPORTED: tuple[Rule, ...] = tuple(
    _rule(cause, Mode.ERROR, raised_in, _reported(cause), remedy)
    for cause, raised_in, remedy in (
        (Cause.TASK_DIED, _ALWAYS, Remedy.READ_LOG_AND_RESTART),
        (Cause.RECORDER_FAILED, _ALWAYS, Remedy.RESTART),
        (Cause.UNREACHABLE, _ALWAYS, Remedy.RESTORE_SOCKET_FOLDER),
        (Cause.DAEMON_ENDS, _NEVER, Remedy.START_DAEMON),
    )
)
"""What the kernel is told, and cannot know by itself."""

RULES: tuple[Rule, ...] = (
    _rule(Cause.OPERATOR_STOP, Mode.EMERGENCY_STOP, _NEVER, _healthy, Remedy.RELEASE_STOP),
    Rule(
        Cause.BATTERY_LOW,
        Mode.EMERGENCY_STOP,
        _MOVING,
        _battery_at_stop,
        _battery_before_clear,
        Remedy.CHARGE_BATTERY,
    ),
    *_REPORTED,
    _rule(
        Cause.LOOP_STALLED,
        Mode.ERROR,
        _MOVING,
        _healthy,
        Remedy.FREE_PROCESSOR,
    ),
    _rule(
        Cause.TICK_OVERRUN,
        Mode.ERROR,
        _MOVING,
        _tick_overrun,
        Remedy.FREE_PROCESSOR_OR_LOWER_RATE,
    ),
    _rule(
        Cause.ODOMETRY_WRONG,
        Mode.ERROR,
        _MOVING,
        _odometry_wrong,
        Remedy.CHECK_ODOMETRY_SOURCE,
    ),
    _rule(
        Cause.ODOMETRY_LOST,
        Mode.ERROR,
        _MOVING,
        _odometry_lost,
        Remedy.CHECK_ODOMETRY_IS_PUBLISHED,
    ),
    _rule(
        Cause.ODOMETRY_CONTRADICTED,
        Mode.ERROR,
        _MOVING,
        _odometry_contradicted,
        Remedy.STOP_ONE_ODOMETRY_PUBLISHER,
    ),
    _rule(
        Cause.SECOND_ODOMETRY,
        Mode.ERROR,
        _NEVER,
        _second_odometry,
        Remedy.STOP_ONE_ODOMETRY_PUBLISHER,
    ),
    _rule(
        Cause.TRACKING_LOST,
        Mode.ERROR,
        _MOVING,
        _tracking_lost,
        Remedy.CHECK_WHEELS,
    ),
    _rule(
        Cause.FOREIGN_PUBLISHER,
        Mode.ERROR,
        _MOVING,
        _foreign_publisher,
        Remedy.STOP_COMMAND_PUBLISHER,
    ),
    _rule(
        Cause.COMMAND_UNHEARD,
        Mode.ERROR,
        _NEVER,
        _command_unheard,
        Remedy.START_BASE,
    ),
    _rule(
        Cause.BATTERY_UNKNOWN,
        Mode.ERROR,
        _MOVING,
        _battery_unknown,
        Remedy.CHECK_BATTERY_TOPIC,
    ),
    _rule(Cause.OPERATOR_ERROR, Mode.ERROR, _NEVER, _healthy, Remedy.CLEAR_ERROR),
)
"""Every cause, the most severe first."""

RULE_OF: Mapping[Cause, Rule] = MappingProxyType({rule.cause: rule for rule in RULES})

FAULT_TRIGGERS: Mapping[Mode, Trigger] = MappingProxyType(
    {Mode.ERROR: Trigger.FAULT_ERROR, Mode.EMERGENCY_STOP: Trigger.FAULT_EMERGENCY_STOP}
)


@dataclass(frozen=True, slots=True)
class Finding:
    """A rule that applies now, and what it found."""

    rule: Rule
    detail: str

    @property
    def cause(self) -> Cause:
        """The cause that the rule is about."""
        return self.rule.cause

    @property
    def remedies(self) -> tuple[Remedy, ...]:
        """What the operator can do about it."""
        return (self.rule.remedy,)


_RULES_IN: tuple[tuple[Rule, ...], ...] = tuple(
    tuple(rule for rule in RULES if mode in rule.raised_in and rule.present is not _healthy)
    for mode in Mode
)
_MEASURED_IN: tuple[tuple[Rule, ...], ...] = tuple(
    tuple(rule for rule in rules if rule not in _REPORTED) for rules in _RULES_IN
)
"""Those that can be present while nothing is reported: this is asked at each step."""


def raised(mode: Mode, health: Health, params: KernelParams, t_ns: int) -> Finding | None:
    """Return the most severe rule that must change `mode` now."""
    rules = _RULES_IN if health.reported else _MEASURED_IN
    return _first_present(rules[mode], health, params, t_ns)


def failed_start_condition(health: Health, params: KernelParams, t_ns: int) -> Finding | None:
    """Return the most severe reason not to start moving."""
    return _first_present(RULES, health, params, t_ns)


def _first_present(
    rules: tuple[Rule, ...], health: Health, params: KernelParams, t_ns: int
) -> Finding | None:
    for rule in rules:
        detail = rule.present(health, params, t_ns)
        if detail:
            return Finding(rule, detail)
    return None


def remedies_for(cause: Cause | None) -> tuple[Remedy, ...]:
    """Return what the operator can do about the cause of a mode, () where there is no cause."""
    return () if cause is None else (RULE_OF[cause].remedy,)


def remedies_to_move(cause: Cause) -> tuple[Remedy, ...]:
    """Return what must be done in ERROR or EMERGENCY_STOP before the robot can move again."""
    remedy = RULE_OF[cause].remedy
    return (remedy,) if remedy in RESETTING else (remedy, Remedy.RESET)


def uncleared(cause: Cause, health: Health, params: KernelParams, t_ns: int) -> Finding | None:
    """Return why `cause` still holds the robot, if it does."""
    rule = RULE_OF[cause]
    detail = rule.hindrance(health, params, t_ns)
    return Finding(rule, detail) if detail else None
