"""Events and durations as sentences."""

from __future__ import annotations

from math import nan

from robotctl.kernel.drive import Drive
from robotctl.kernel.modes import Mode
from robotctl.kernel.patterns import named
from robotctl.kernel.state import FULLEST_LEVEL
from robotctl.kernel.types import (
    BatteryReceived,
    CommandListenersSeen,
    CommandPublishersSeen,
    DriveReport,
    DriveRequested,
    Event,
    FaultCleared,
    FaultReported,
    ForeignCommandHeard,
    GuardedCommandReceived,
    HoldReceived,
    LoopStalled,
    ModeRequested,
    OdometrySourceFound,
    OdomReceived,
    ResetRequested,
    SafetyInputReceived,
    ScanReceived,
    Tick,
)
from robotctl.kernel.types.events import (
    LeaseLost,
    LeaseRequested,
    LifecycleChanged,
    ParameterRequested,
)
from robotctl.kernel.units import NS_PER_S


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
            names = ", ".join(event.names) or "no other node"
            return f"{names} publishes velocity commands, too"
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
            nearest_m = min(event.sectors, default=nan)
            return f"a laser scan, nearest {nearest_m:.2f} m"
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
    """Describe how far a drive has come, and how far off its path (a held velocity has no path)."""
    laps = f"{report.laps} lap{'' if report.laps == 1 else 's'} and {report.distance_m:.2f} m"
    if drive is not None and drive.course.held is not None:
        return laps
    return (
        f"{laps}, off track {report.cross_track_rms_m:.3f} m RMS, "
        f"at most {report.cross_track_max_m:.3f}"
    )
