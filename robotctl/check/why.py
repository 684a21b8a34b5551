"""Explain an incident in sentences: the event, the rule, the request, the effects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import nan
from types import MappingProxyType
from typing import assert_never

from robotctl.check.incident import Incident, IncidentKind
from robotctl.config import Config, flat
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.drive import Drive
from robotctl.kernel.modes import REQUESTS, TRANSITIONS, Guard, Mode, Trigger
from robotctl.kernel.patterns import named
from robotctl.kernel.safety import RULE_OF, Rule, failed_start_condition, remedies_for, uncleared
from robotctl.kernel.state import FULLEST_LEVEL, State
from robotctl.kernel.types import (
    BatteryReceived,
    Cause,
    CommandListenersSeen,
    CommandPublishersSeen,
    DriveEnded,
    DriveReport,
    DriveRequested,
    Event,
    FaultCleared,
    FaultReported,
    ForeignCommandHeard,
    GuardedCommandReceived,
    HoldReceived,
    LatchEmergencyStop,
    LeaseLost,
    LeaseRequested,
    LifecycleChanged,
    LoopStalled,
    ModeChanged,
    ModeRequested,
    OdometrySourceFound,
    OdomReceived,
    ParameterChanged,
    ParameterRequested,
    Phase,
    PublishTwist,
    ReleaseEmergencyStop,
    Remedy,
    Reply,
    ResetRequested,
    SafetyInputReceived,
    ScanReceived,
    Tick,
)


def sentence_of(event: Event) -> str:
    """Describe an input event of the kernel in a phrase: lower case, no full stop."""
    match event:
        case Tick():
            missed = f", {event.missed} were missed before it" if event.missed else ""
            return f"a control tick{missed}"
        case OdomReceived():
            pose = event.odometry.pose
            return f"odometry: x {pose.x:.3f} m, y {pose.y:.3f} m, theta {pose.theta:.3f} rad"
        case BatteryReceived():
            level = event.level
            shown = f"{level:.1%}" if level <= FULLEST_LEVEL else f"{level:g} as its gauge counts"
            return f"a battery level of {shown}"
        case ModeRequested():
            return f"a request for {_mode_name(event.requested)} by {event.source}"
        case ResetRequested():
            return f"a reset by {event.source}"
        case DriveRequested():
            return f"a request to drive {named(event.pattern, event.course)} by {event.source}"
        case ParameterRequested():
            return (
                f"a request to change {event.key} from {event.old} to {event.new} by {event.source}"
            )
        case GuardedCommandReceived():
            twist = event.twist
            return f"a wanted velocity of {twist.linear:.2f} m/s, {twist.angular:.2f} rad/s"
        case HoldReceived():
            twist = event.twist
            return f"a held velocity of {twist.linear:.2f} m/s, {twist.angular:.2f} rad/s"
        case LeaseRequested():
            return f"a request to {'take' if event.take else 'release'} the lease by {event.source}"
        case LeaseLost():
            return f"the loss of the lease by its holder: {event.how}"
        case CommandPublishersSeen():
            return f"{', '.join(event.names) or 'no other node'} publishes velocity commands, too"
        case ForeignCommandHeard():
            return f"a velocity command of {event.publisher}"
        case CommandListenersSeen():
            return f"{event.count} nodes take the velocity command"
        case LifecycleChanged():
            return f"mode_service became {event.state.value} by {event.source}"
        case SafetyInputReceived():
            text = f" ({event.detail})" if event.detail else ""
            return f"a message of the safety input {event.kind.value}, {event.value:g}{text}"
        case ScanReceived():
            return f"a laser scan, nearest {min(event.sectors, default=nan):.2f} m"
        case OdometrySourceFound():
            return f"odometry of one more publisher, {event.name}"
        case LoopStalled():
            return f"a stall of the control loop for {event.stalled_s:.2f} s ({event.detail})"
        case FaultReported():
            return f"a report of the daemon, {event.cause.value}: {event.detail}"
        case FaultCleared():
            return f"a report of the daemon, {event.cause.value}: works again"


def _mode_name(number: int) -> str:
    return Mode(number).name if number in list(Mode) else f"mode {number}"


def span(duration_ns: int) -> str:
    """Return a duration as text, in whole ms, in s with one decimal, or in whole minutes."""
    seconds = duration_ns / NS_PER_S
    if abs(seconds) < 1.0:
        return f"{seconds * 1e3:.0f} ms"
    return f"{seconds:.1f} s" if abs(seconds) < 120.0 else f"{seconds / 60.0:.0f} min"


def driven(report: DriveReport, drive: Drive | None) -> str:
    """Describe the distance of a drive and, unless it held a velocity, its tracking errors."""
    laps = f"{report.laps} lap{'' if report.laps == 1 else 's'} and {report.distance_m:.2f} m"
    if drive is not None and drive.course.held is not None:
        return laps
    return (
        f"{laps}, off track {report.cross_track_rms_m:.3f} m RMS, "
        f"at most {report.cross_track_max_m:.3f}"
    )


_MEASURES: Mapping[Cause, tuple[str, ...]] = MappingProxyType(
    {
        Cause.BATTERY_LOW: ("battery.stop_level", "battery.clear_level"),
        Cause.BATTERY_UNKNOWN: ("battery.timeout_s", "battery.scale"),
        Cause.ODOMETRY_LOST: ("odometry.timeout_s",),
        Cause.ODOMETRY_WRONG: ("odometry.max_jump_m", "odometry.max_jump_rad"),
        Cause.ODOMETRY_CONTRADICTED: ("odometry.max_jump_m", "odometry.max_jump_rad"),
        Cause.SECOND_ODOMETRY: ("odometry.timeout_s",),
        Cause.TRACKING_LOST: ("tracking.max_error_m",),
        Cause.LOOP_STALLED: ("max_tick_gap_s",),
        Cause.TICK_OVERRUN: ("max_tick_gap_s",),
    }
)
"""The parameters whose values each rule compares."""

_LET_GO = "let go, the robot ramps down"
_SILENT = "a silence is zero at once, and ends the motion"


@dataclass(frozen=True, slots=True)
class Why:
    """The explanation of an incident; an unknown part is "" or ()."""

    what: str
    remedies: tuple[Remedy, ...]
    came_in: str
    known: str
    rule: str
    asked: str
    went_out: tuple[str, ...]
    since: str


def explain(incident: Incident) -> Why:
    """Explain an incident: what happened, the input, the rule, the request and the effects."""
    return Why(
        what=_what(incident),
        remedies=_remedies(incident),
        came_in=_came_in(incident),
        known=_known(incident),
        rule=_rule(incident),
        asked=_asked(incident),
        went_out=tuple(_went_out(incident)),
        since=_since(incident),
    )


def rule_of(incident: Incident) -> Rule | None:
    """Return the safety rule that caused the incident, or None if no rule of the table did."""
    before, after, params = incident.before, incident.after, incident.params
    if before is None or after is None or params is None:
        return None
    if incident.kind is not IncidentKind.REFUSAL:
        changed = any(isinstance(effect, ModeChanged) for effect in incident.effects)
        return RULE_OF[after.cause] if changed and after.cause is not None else None
    finding = failed_start_condition(before.health, params, incident.t_ns)
    if before.cause is not None:
        finding = uncleared(before.cause, before.health, params, incident.t_ns)
    refused = _refusal(incident)
    if finding is None or refused is None or finding.detail not in refused.message:
        return None
    return finding.rule


def _what(incident: Incident) -> str:
    if incident.kind is IncidentKind.KILL:
        return "the recording ends while MOVING: the daemon was killed, or could write no more"
    for effect in incident.effects:
        if isinstance(effect, ModeChanged):
            return f"{effect.previous.name} -> {effect.mode.name}: {effect.reason}"
    refused = _refusal(incident)
    return f"refused: {refused.message}" if refused else ""


def _remedies(incident: Incident) -> tuple[Remedy, ...]:
    for effect in incident.effects:
        if isinstance(effect, ModeChanged) and incident.kind is IncidentKind.FAULT:
            return remedies_for(effect.cause)
        if isinstance(effect, Reply) and not effect.ok:
            return effect.remedies
    return ()


def _refusal(incident: Incident) -> Reply | None:
    for effect in incident.effects:
        if isinstance(effect, Reply) and not effect.ok:
            return effect
    return None


def _came_in(incident: Incident) -> str:
    if incident.kind is IncidentKind.KILL:
        return (
            "nothing that was recorded: the process was killed, the machine lost power, "
            "or the disk took no more"
        )
    before = incident.before
    if incident.ramp is None and before is not None and before.phase is Phase.STOPPING:
        return f"{before.stop_reason}: the ramp began before this recording"
    if incident.ramp is None:
        return sentence_of(incident.event)
    t_ns, event = incident.ramp
    return f"{sentence_of(event)}, {span(incident.t_ns - t_ns)} before the robot stood"


def _known(incident: Incident) -> str:
    """Return the facts that the kernel knew."""
    state = incident.after
    if state is None or incident.params is None:
        return "unknown: the journal has a gap or no snapshot before"
    health, facts = state.health, []
    if health.odometry is None:
        facts.append("no odometry yet")
    else:
        # The odometry may be newer than a late tick: its age is then 0.
        age_ns = max(incident.t_ns - health.odometry_t_ns, 0)
        facts.append(f"odometry {span(age_ns)} old")
    if incident.params.battery.topic:
        level = health.battery_level
        facts.append("battery unknown" if level is None else f"battery {level:.0%}")
    before = incident.before
    if before is not None and before.mode is Mode.MOVING:
        command = before.command
        facts.append(f"commanded {command.linear:.3f} m/s, {command.angular:.3f} rad/s")
        if before.drive is not None:
            facts.append(f"{before.drive.score.error_m:.3f} m from where it should be")
    if health.foreign_publishers:
        facts.append(f"velocity commands also by {', '.join(health.foreign_publishers)}")
    facts += [f"{cause.value}: {detail}" for cause, detail in health.reported]
    return "; ".join(facts)


def _rule(incident: Incident) -> str:
    """Return the rule and its parameters, "" if the rule is unknown."""
    before, params = incident.before, incident.params
    if before is None or params is None or incident.kind is IncidentKind.KILL:
        return ""
    rule = rule_of(incident)
    if rule is None:
        return _table_rule(incident, before)
    values = flat(Config(kernel=params))
    texts = [f"{key} is {values[key]}" for key in _MEASURES.get(rule.cause, ())]
    measures = f" ({', '.join(texts)})" if texts else ""
    if incident.kind is IncidentKind.REFUSAL:
        holds = f"holds {before.mode.name}" if before.cause is not None else "prevents a start"
        return f"{rule.cause.value} {holds}{measures}"
    if not rule.raised_in:
        return f"{rule.cause.value}: a request for {rule.action.name} is always granted"
    modes = " and ".join(mode.name for mode in sorted(rule.raised_in))
    return f"{rule.cause.value}: in {modes} it leads to {rule.action.name}{measures}"


def _table_rule(incident: Incident, before: State) -> str:
    """Return the rule outside the safety table: table of modes, lease, end of a drive."""
    event = incident.ramp[1] if incident.ramp else incident.event
    if Remedy.WAIT_FOR_LEASE in _remedies(incident):
        return "the lease: its holder alone starts and steers motion"
    match event:
        case ModeRequested() if event.requested in list(Mode):
            trigger = REQUESTS[Mode(event.requested)]
        case ResetRequested():
            trigger = Trigger.RESET
        case DriveRequested():
            trigger = Trigger.REQUEST_MOVING
        case LeaseLost() | LeaseRequested():
            return "the lease: motion ends with it"
        case _:
            drive = before.drive if incident.kind is IncidentKind.STOP else None
            held = None if drive is None else drive.course.held
            if held is not None and held.is_held_to_run:
                return "hold to run: " + (_LET_GO if held.is_let_go else _SILENT)
            return "the drive was over" if drive is not None and drive.finished else ""
    mode = Mode.MOVING if incident.ramp else before.mode
    transition = TRANSITIONS[mode, trigger]
    if transition.guard is Guard.NEVER:
        return f"the table of modes: {trigger.value} is refused in {mode.name}"
    if incident.kind is IncidentKind.REFUSAL:
        return _other_refusal(event, before)
    condition = "" if transition.guard is Guard.NONE else f", {transition.guard.value}"
    return (
        f"the table of modes: {trigger.value} in {mode.name}: {transition.target.name}{condition}"
    )


def _other_refusal(event: Event, before: State) -> str:
    """Return the rule of a refusal outside the tables of safety and modes, or ""."""
    if before.phase is Phase.STOPPING:
        return "while the robot ramps down, nothing starts"
    if isinstance(event, DriveRequested) and before.mode is Mode.MOVING and not event.replace:
        return "one drive at a time: a second one must replace the first"
    return ""


def _asked(incident: Incident) -> str:
    """Return the motion that ended and its requester; "" without a motion."""
    before = incident.before
    if before is None or before.mode is not Mode.MOVING:
        return ""
    who = before.reason.removeprefix("requested by ")
    drive = before.drive
    what = named(drive.pattern, drive.course) if drive else "to move"
    if incident.moving_since_ns is None:
        return f"{what}: {who}"
    return f"{what}: {who}, {span(incident.t_ns - incident.moving_since_ns)} before"


def _went_out(incident: Incident) -> Iterator[str]:
    if incident.kind is IncidentKind.KILL:
        yield "no recorded zero velocity: after a kill, the robot stops by its own command timeout"
        return
    for effect in incident.effects:
        match effect:
            case PublishTwist():
                yield _zero(incident)
            case ParameterChanged():
                yield f"{effect.key} changed from {effect.old} to {effect.new}"
            case LatchEmergencyStop():
                yield "the emergency stop is latched, also over a restart"
            case ReleaseEmergencyStop():
                yield "the emergency stop is released"
            case DriveEnded():
                drive = None if incident.before is None else incident.before.drive
                yield f"the drive ended after {driven(effect.report, drive)}"
            case Reply() if effect.ok:
                yield f"answered: {effect.message}"
            case Reply() | ModeChanged():
                pass  # already told by `what`
            case _:
                assert_never(effect)


def _zero(incident: Incident) -> str:
    ramp = ""
    if incident.ramp is not None:
        ramp = f"ramped down in {span(incident.t_ns - incident.ramp[0])}, then "
    if incident.zero_ns is None:
        return f"{ramp}zero velocity; the recording does not hold the message"
    after_ms = (incident.zero_ns - incident.log_ns) / 1e6
    return f"{ramp}zero velocity, sent {after_ms:.2f} ms after"


def _since(incident: Incident) -> str:
    if incident.next_change is not None:
        t_ns, change = incident.next_change
        after = span(t_ns - incident.t_ns)
        return f"{after} later {change.previous.name} -> {change.mode.name}: {change.reason}"
    if incident.after is None or incident.kind is IncidentKind.KILL:
        return ""
    return f"{incident.after.mode.name} to the end of the recording"
