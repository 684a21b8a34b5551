"""The status of a daemon as text: one screen 80 columns wide."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from robotctl.cli.ui.text import (
    UNLIMITED,
    column_width,
    columns,
    duration,
    elided,
    number,
    printable,
    row,
    short_path,
    size,
)

if TYPE_CHECKING:  # `robotctl status` starts without it
    from robotctl.ipc.answers import Status

_MIN_NAME_WIDTH, _COUNT_WIDTH, _RATE_WIDTH = 24, 8, 7
_INDENT_AND_GAPS = 5


def topic_table(topics: Iterable[tuple[object, object, object, object]]) -> list[str]:
    """Return a header and a line for each topic: its name, type, message count and rate [Hz]."""
    rows: list[tuple[object, object, object, str]] = [("topic", "type", "count", "Hz")]
    for name, kind, count, hertz in topics:
        rate = number(hertz, ".1f")
        rate = rate if len(rate) <= _RATE_WIDTH else number(hertz, ".1e")
        rows.append((name, str(kind).replace("/msg/", "/"), count, rate))
    both = columns() - _INDENT_AND_GAPS - _COUNT_WIDTH - _RATE_WIDTH
    names = (name for name, *_ in rows)
    wide = column_width(names, at_least=_MIN_NAME_WIDTH, at_most=both * 2 // 3)
    rest = both - wide
    if columns() == UNLIMITED:
        rest = column_width((kind for _, kind, *_ in rows), at_least=1, at_most=rest)
    return [
        f"  {elided(name, wide):{wide}} {elided(kind, rest):{rest}} "
        f"{count!s:>{_COUNT_WIDTH}} {rate:>{_RATE_WIDTH}}"
        for name, kind, count, rate in rows
    ]


_LABEL_WIDTH = 10

OBSERVING = "observing (only records)"


def status_screen_lines(status: Status) -> Iterator[str]:
    """Yield the lines of `robotctl status`, from the object of `status --json`."""
    yield headline(status)
    if status.get("mode_reason"):
        yield from row(f"  {'reason':{_LABEL_WIDTH}} ", status["mode_reason"])
    yield from (f"  {label:{_LABEL_WIDTH}} {text}" for label, text in status_rows(status))
    if status["topics"]:
        table = topic_table((t["name"], t["type"], t["count"], t["rate"]) for t in status["topics"])
        yield from ("", *table)
    for warning in status["warnings"]:
        yield from row("warning: ", warning)


def headline(status: Status) -> str:
    """Return the name of the robot, its mode and phase."""
    phase = status.get("phase")
    suffix = f" ({printable(phase)})" if phase else ""
    return f"{printable(status.get('robot'))}: {mode_text(status)}{suffix}"


def mode_text(status: Mapping[str, Any]) -> str:
    """Return the mode, or OBSERVING for a daemon that only records."""
    return OBSERVING if is_observer(status) else printable(status.get("mode"))


def is_observer(status: Mapping[str, Any]) -> bool:
    """Return whether the daemon only records and controls no robot."""
    return "mode" in status and status["mode"] is None


def status_rows(status: Status) -> Iterator[tuple[str, str]]:
    """Yield label and text of each row of `robotctl status`, except for reason and topics."""
    if not is_observer(status):
        yield "pose", pose_text(status)
        yield "velocity", velocity_text(status)
        yield "battery", battery_text(status)
        drive = status.get("drive")
        if drive:
            what, *errors = drive_lines(drive)
            yield "drive", what
            yield from (("", line) for line in errors)
        if status.get("lease"):
            yield "lease", printable(status["lease"])
        yield "simulator", "yes" if status.get("sim") else "no"
    recorder = status["recorder"]
    yield "recorder", f"{printable(recorder.get('state'))}, {size(recorder.get('bytes') or 0)}"
    counts = ("received", "written", "queued", "dropped", "lost")
    yield "messages", ", ".join(f"{recorder.get(name, 0)} {name}" for name in counts)
    if recorder.get("throttled"):
        yield "", f"{recorder['throttled']} throttled"
    if recorder.get("file"):
        yield "file", short_path(recorder["file"])
    domain, discovery = status.get("domain_id"), status.get("discovery_range")
    yield "ROS", f"domain {domain}, discovery {printable(discovery)}"
    yield "socket", printable(status.get("socket"))
    version, pid = printable(status.get("version")), status.get("pid")
    if status.get("scheduling") not in (None, "SCHED_OTHER"):
        yield "scheduling", printable(status["scheduling"])
    yield "daemon", f"robotctl {version}, pid {pid}, up {duration(status.get('uptime_s') or 0)}"


def pose_text(status: Mapping[str, Any]) -> str:
    """Return the pose in `status`, relative to the odometry frame, as text."""
    pose = status.get("pose")
    if not pose:
        return "unknown (no odometry yet)"
    x, y, theta = (number(pose.get(key), "+.3f") for key in ("x", "y", "theta"))
    return f"x {x} m   y {y} m   theta {theta} rad"


def drive_lines(drive: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines about a drive and its errors [m, rad]."""
    now, rms, worst, true_m, heading, most, closure = (
        number(drive.get(key), ".3f")
        for key in (
            *("cross_track_m", "cross_track_rms_m", "cross_track_max_m", "true_cross_track_max_m"),
            *("heading_rms_rad", "heading_max_rad", "closure_m"),
        )
    )
    laps = f" of {drive['laps']}" if drive.get("laps") else ""
    seconds = number(drive.get("duration_s"), ".1f")
    yield f"{printable(drive.get('what'))}, lap {drive.get('lap')}{laps}, for {seconds} s"
    in_truth = "" if drive.get("true_cross_track_max_m") is None else f" ({true_m} m in truth)"
    if drive.get("cross_track_rms_m") is not None:
        yield f"off track {now} m, {rms} m RMS, {worst} m at most{in_truth}"
    closed = "" if drive.get("closure_m") is None else f", closure {closure} m"
    if drive.get("heading_rms_rad") is not None:
        yield f"heading {heading} rad RMS, {most} rad at most{closed}"


def velocity_text(status: Mapping[str, Any]) -> str:
    """Return the measured velocity in `status` as text."""
    velocity = status.get("velocity") or {}
    linear, angular = (number(velocity.get(key), "+.3f") for key in ("linear", "angular"))
    return f"{linear} m/s   {angular} rad/s"


def battery_text(status: Status) -> str:
    """Return the battery level in percent."""
    battery = status.get("battery")
    return "unknown" if battery is None else f"{number(battery, '.0%')}".replace("%", " %")
