"""The shape of a requested drive: its size, and what else shapes it."""

from __future__ import annotations

from robotctl.errors import UsageError
from robotctl.ipc.params import DriveParams, DrivePathParams
from robotctl.kernel.course import PLAIN, Course
from robotctl.kernel.patterns import SHAPES, PatternKind, SizeName


def default_laps(kind: PatternKind, *, wait: bool) -> int:
    """Return the laps of a drive where none are asked for; 0 is until stopped."""
    return 1 if wait or not SHAPES[kind].closed else 0


def shape_size_m(params: DriveParams) -> float | None:
    """Return the size that was asked for, None if none was.

    Raises:
        UsageError: A size was given that the pattern does not have.
    """
    kind = params.pattern
    wanted = SHAPES[kind].size_name
    sizes_m = {
        SizeName.SIDE: params.side_m,
        SizeName.RADIUS: params.radius_m,
        SizeName.LENGTH: params.length_m,
    }
    for name, size_m in sizes_m.items():
        if size_m is not None and name is not wanted:
            use = f": use --{wanted.value}" if wanted else ""
            raise UsageError(f"a {kind.value} has no {name.value}{use}")
    return None if wanted is None else sizes_m[wanted]


def shape_course(params: DriveParams) -> Course:
    """Return how the pattern is driven.

    Raises:
        UsageError: The pattern has no corners, or no angle.
    """
    shape, name = SHAPES[params.pattern], params.pattern.value
    if params.corner_m is not None and not shape.has_corner:
        raise UsageError(f"a {name} has no rounded corners")
    if params.angle_rad is not None and not shape.has_angle:
        raise UsageError(f"a {name} has no angle")
    return Course(
        corner_m=PLAIN.corner_m if params.corner_m is None else params.corner_m,
        angle_rad=PLAIN.angle_rad if params.angle_rad is None else params.angle_rad,
        reverse=params.reverse,
        open_loop=params.open_loop,
    )


def path_course(params: DrivePathParams) -> Course:
    """Return how waypoints are driven."""
    return Course(
        corner_m=PLAIN.corner_m if params.corner_m is None else params.corner_m,
        reverse=params.reverse,
        open_loop=params.open_loop,
        waypoints=tuple(params.points),
        frame=params.frame,
    )
