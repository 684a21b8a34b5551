"""What `robotctl drive` can be asked for, and which options belong to which motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from math import isfinite
from typing import Any

from robotctl.cli.commands.drive.waypoint_file import read_waypoints
from robotctl.cli.terminal.text import printable
from robotctl.errors import UsageError
from robotctl.ipc.protocol import MAX_REASON
from robotctl.kernel.course import MAX_HELD_S, MIN_HELD_S, Frame
from robotctl.kernel.patterns import SHAPES, PatternKind

PATTERNS = ", ".join(kind.value for kind in PatternKind)
PATH, VELOCITY = "path", "velocity"
MOTIONS = [*(kind.value for kind in PatternKind), PATH, VELOCITY]

FOLLOWED = frozenset({"laps", "speed", "reverse", "open-loop"})
"""The options of every motion that follows a path."""

_OWNERS = {
    "frame": "the path of a file",
    "topic": "a path",
    "for": "a velocity",
    "corner": "a rounded-square or a path",
    "angle": "an arc or a turn",
}
"""The motions that have an option which others lack."""


def checked_values(motion: str, given: Sequence[str] | None, topic: str = "") -> list[str]:
    """Return what is given after the motion; a path may be that of a topic.

    Raises:
        UsageError: There is no such motion, or too much or too little is given.
    """
    values = list(given or ())
    for value in (motion, *values):
        if value.startswith("-") and not _is_float(value):
            raise UsageError(f"No such option: {printable(value)}")
    if motion not in MOTIONS:
        shown = f"{printable(motion)!r} is not one of"
        wrong = shown if motion else "Missing argument 'PATTERN'. Choose from:"
        raise UsageError(f"{wrong} {', '.join(MOTIONS)}")
    if motion == VELOCITY:
        if len(values) != 2 or not all(map(_is_number, values)):
            raise UsageError("a velocity is two numbers", "such as robotctl drive velocity 0.2 0")
    elif motion == PATH and topic:
        if values:
            raise UsageError("a path has one FILE or one --topic, not both")
    elif motion == PATH and (len(values) != 1 or not values[0]):
        cure = "use CSV with the header x,y, YAML, or a recording"
        raise UsageError("a path has one FILE" if any(values) else "a path needs a FILE", cure)
    elif motion != PATH and values:
        raise UsageError(f"a {motion} has no file", "use robotctl drive path FILE")
    return values


def options_of(pattern: PatternKind) -> frozenset[str]:
    """Return the options that fit a pattern."""
    shape = SHAPES[pattern]
    size = {shape.size_name.value} if shape.size_name else set()
    corner = {"corner"} if shape.has_corner else set()
    return FOLLOWED | size | corner | ({"angle"} if shape.has_angle else set())


def cure_of(pattern: PatternKind) -> str:
    """Return which size a pattern has, "" if it has none."""
    name = SHAPES[pattern].size_name
    return f"use --{name.value}" if name else ""


def refuse_options(
    what: str, options: Mapping[str, object], *, allowed: Collection[str], cure: str = ""
) -> None:
    """Check which options are given; `cure` says which size to use instead of another.

    Raises:
        UsageError: One of them does not fit.
    """
    for name, value in options.items():
        if value is not None and name not in allowed:
            if name in _OWNERS:
                cure = f"it is for {_OWNERS[name]}"
            elif name in FOLLOWED:
                cure = ""
            raise UsageError(f"{what} has no --{name}", cure)


def path_params(robot: str, values: Sequence[str], frame: Frame) -> dict[str, Any]:
    """Return what a path takes beyond every drive.

    Raises:
        UsageError: There is no such file.
        Refused: It is `last`, and the robot has no recording.
        UnreadableFile: The file holds no path.
    """
    return {"points": read_waypoints(values[0], frame, robot), "frame": frame.value}


def topic_params(robot: str, topic: str, reason: str) -> dict[str, Any]:
    """Wait for a path on a topic, and return what it takes beyond every drive.

    Raises:
        Refused: The message holds no path that can be driven.
    """
    from robotctl.cli.commands.drive.path_topic import heard_path  # here: others hear no topic

    name, points, frame = heard_path(robot, topic)
    reason = reason or f"the path of {name}"[:MAX_REASON]
    return {"points": points, "frame": frame.value, "reason": reason}


def velocity_params(values: Sequence[str], duration: str | None) -> dict[str, Any]:
    """Return what a velocity takes beyond every drive.

    Raises:
        UsageError: There is no duration, or it is not allowed.
    """
    seconds = (duration or "").removesuffix("s")
    for_s = float(seconds) if _is_number(seconds) else 0.0
    if not MIN_HELD_S <= for_s <= MAX_HELD_S:
        text = f"--for {printable(duration)}" if duration else "a velocity needs --for"
        raise UsageError(text, f"use {MIN_HELD_S:g} to {MAX_HELD_S:g} s, such as --for 2s")
    linear_mps, angular_rps = map(float, values)
    return {"linear_mps": linear_mps, "angular_rps": angular_rps, "for_s": for_s}


def _is_number(text: str) -> bool:
    return _is_float(text) and isfinite(float(text))


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
