"""The parameters of each method with their limits."""

from __future__ import annotations

from reprlib import repr as short_repr
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct

from robotctl.base.errors import UsageError
from robotctl.ipc.protocol import MAX_GRAPH_NAME, MAX_MARK_LENGTH, MAX_REASON, REASON_PATTERN
from robotctl.kernel.course import (
    MAX_ANGLE_RAD,
    MAX_CORNER_M,
    MAX_HELD_S,
    MAX_POINTS,
    MAX_QUIET_S,
    MIN_CORNER_M,
    MIN_HELD_S,
    Frame,
)
from robotctl.kernel.drive import MAX_LAPS
from robotctl.kernel.patterns import (
    MAX_SIZE_M,
    MAX_SPEED_MPS,
    MIN_SIZE_M,
    MIN_SPEED_MPS,
    PatternKind,
)

Source = Annotated[str, Meta(max_length=200)]
"""The name of the requester, for the journal and the log."""

Reason = Annotated[str, Meta(max_length=MAX_REASON, pattern=REASON_PATTERN)]
"""The reason for the request, for the journal and the log."""

Token = Annotated[str, Meta(min_length=16, max_length=64)]
"""The token of a lease, a secret of its holder."""

MAX_TURNING_RPS = 20.0
"""The largest allowed value of `limits.angular_rps` [rad/s]."""

Size = Annotated[float, Meta(ge=MIN_SIZE_M, le=MAX_SIZE_M)]


class NoParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of a method that has none."""


class AnyParams(Struct, frozen=True):
    """Parameters of any name and value, for a method that refuses every call."""


class HelloParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `hello`: the protocol version of the client."""

    protocol: int


class SetModeParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `set_mode`. `mode` may be any uint8: the handler refuses unknown modes."""

    mode: Annotated[int, Meta(ge=0, le=255)]
    source: Source
    reason: Reason = ""
    lease: Token | None = None


class ResetParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `reset`, which changes ERROR or EMERGENCY_STOP to IDLE."""

    source: Source
    reason: Reason = ""


class EndDriveParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `end_drive`, which ramps down to IDLE. It has an effect only in MOVING."""

    source: Source


class MarkParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `mark`, which marks the current time in the recording."""

    text: Annotated[str, Meta(min_length=1, max_length=MAX_MARK_LENGTH)]
    source: Source


class ParamSetParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `param_set`: a key of the configuration and its new value as text."""

    key: Annotated[str, Meta(max_length=100)]
    value: Annotated[str, Meta(max_length=1000)]
    source: Source


class GraphNameParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `graph_topic` and `graph_node`: the full name of the topic or node."""

    name: Annotated[str, Meta(min_length=1, max_length=MAX_GRAPH_NAME)]


class SimSetParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `sim_set`: the battery level of the simulated robot."""

    battery: Annotated[float, Meta(ge=0.0, le=1.0)]
    source: Source


class SimFaultParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `sim_fault`: the fault, and its duration [s]."""

    fault: Annotated[str, Meta(max_length=40)]
    for_s: Annotated[float, Meta(gt=0.0, le=60.0)]
    source: Source


class MotionParams(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The common parameters of a motion. With `wait`, the reply comes after the motion."""

    source: Source
    replace: bool = False
    wait: bool = False
    reason: Reason = ""
    lease: Token | None = None


class CourseParams(MotionParams, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The common parameters of `drive` and `drive_path`. None stands for a default."""

    reverse: bool = False
    open_loop: bool = False
    laps: Annotated[int, Meta(ge=0, le=MAX_LAPS)] | None = None
    """The number of laps, or 0 to drive until stopped."""
    speed_mps: Annotated[float, Meta(ge=MIN_SPEED_MPS, le=MAX_SPEED_MPS)] | None = None


class DriveParams(CourseParams, frozen=True, forbid_unknown_fields=True):
    """The parameters of `drive`: a pattern and its sizes. None stands for a default."""

    pattern: PatternKind
    side_m: Size | None = None
    radius_m: Size | None = None
    length_m: Size | None = None
    corner_m: Annotated[float, Meta(ge=MIN_CORNER_M, le=MAX_CORNER_M)] | None = None
    angle_rad: Annotated[float, Meta(ge=-MAX_ANGLE_RAD, le=MAX_ANGLE_RAD)] | None = None


class DrivePathParams(CourseParams, frozen=True, forbid_unknown_fields=True):
    """The parameters of `drive_path`: waypoints (x, y) [m] in `frame`, by default for 1 lap."""

    points: Annotated[list[tuple[float, float]], Meta(min_length=2, max_length=MAX_POINTS)]
    frame: Frame = Frame.START
    corner_m: Annotated[float, Meta(ge=0.0, le=MAX_CORNER_M)] | None = None


class DriveVelocityParams(MotionParams, frozen=True, forbid_unknown_fields=True):
    """The parameters of `drive_velocity`: a velocity for `for_s` seconds, then a ramp down."""

    linear_mps: Annotated[float, Meta(ge=-MAX_SPEED_MPS, le=MAX_SPEED_MPS)]
    angular_rps: Annotated[float, Meta(ge=-MAX_TURNING_RPS, le=MAX_TURNING_RPS)]
    for_s: Annotated[float, Meta(ge=MIN_HELD_S, le=MAX_HELD_S)]
    quiet_s: Annotated[float, Meta(ge=0.0, le=MAX_QUIET_S)] = 0.0


class HoldParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `hold`, which drives at a velocity while the client repeats the request."""

    linear_mps: Annotated[float, Meta(ge=-MAX_SPEED_MPS, le=MAX_SPEED_MPS)]
    angular_rps: Annotated[float, Meta(ge=-MAX_TURNING_RPS, le=MAX_TURNING_RPS)]
    source: Source
    hold: Annotated[int, Meta(ge=0)] = 0
    """0 to begin a motion, or the number in the answer to keep that motion going."""
    reason: Reason = ""
    lease: Token | None = None


class LeaseTakeParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `lease_take`. The client chooses the token and keeps it secret."""

    token: Token
    source: Source
    reason: Reason = ""


class LeaseKeepParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `lease_keep`."""

    token: Token


class LeaseReleaseParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `lease_release`."""

    source: Source
    token: Token | None = None


class LeaseStatusParams(Struct, frozen=True, forbid_unknown_fields=True):
    """The parameters of `lease_status`: a token to compare with that of the lease."""

    token: Token | None = None


P = TypeVar("P")


def decode(given: dict[str, Any], kind: type[P]) -> P:
    """Return the parameters as an object of `kind`.

    Raises:
        UsageError: A parameter is unknown, missing or not allowed.
    """
    try:
        return msgspec.convert(given, type=kind)
    except msgspec.ValidationError:
        raise _refusal(given, kind) from None


def _refusal(given: dict[str, Any], kind: type[Any]) -> UsageError:
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    for name, value in given.items():
        if name not in fields:
            return UsageError(f"no parameter {name[:40]!r}", f"use {', '.join(fields) or 'none'}")
        try:
            msgspec.convert(value, type=fields[name].type)
        except msgspec.ValidationError:
            allowed = _allowed(fields[name].type)
            return UsageError(f"{name}: {short_repr(value)} is not allowed", f"use {allowed}")
    missing = [name for name, field in fields.items() if field.required and name not in given]
    return UsageError(f"{', '.join(missing)}: missing")


def _allowed(kind: Any) -> str:
    """Describe the values that a parameter of type `kind` may have."""
    from msgspec import inspect

    info = inspect.type_info(kind)
    if isinstance(info, inspect.UnionType):
        (info,) = (each for each in info.types if not isinstance(each, inspect.NoneType))
    match info:
        case inspect.IntType(ge=None, le=None):
            return "a whole number"
        case inspect.IntType(ge=low, le=high):
            return f"a whole number from {low} to {high}"
        case inspect.FloatType(ge=low, le=high):
            return f"a number from {low:g} to {high:g}"
        case inspect.StrType(min_length=low, max_length=high, pattern=pattern):
            suffix = " without control characters" if pattern else ""
            return f"a text of {low or 0} to {high} characters{suffix}"
        case inspect.EnumType(cls=members):
            return ", ".join(str(member.value) for member in members)
        case _:
            return "true or false"
