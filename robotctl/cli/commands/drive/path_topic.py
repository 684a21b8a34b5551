"""The points of a path that a node publishes, as `nav_msgs/Path`."""

from __future__ import annotations

import base64
import struct
import sys
from collections.abc import Mapping
from math import isfinite
from typing import Any, Final

from robotctl.cdr.definition import Definition, parse_definition
from robotctl.cdr.values import decode
from robotctl.cli.support.ros_view import ros_view
from robotctl.cli.terminal.text import printable
from robotctl.errors import Refused
from robotctl.ipc.client import call
from robotctl.ipc.method_names import PARAM_LIST
from robotctl.kernel.course import MAX_POINTS, Frame

PATH_TYPE: Final = "nav_msgs/msg/Path"

MAX_BYTES: Final = 512 * MAX_POINTS
"""More than any path needs: a pose takes about 100 bytes."""

NOTE_S: Final = 2.0
"""Without a message for this time, a line on stderr says that the command still waits."""

ODOMETRY_FRAME: Final = "odom"
"""The frame of odometry (REP 105), unless `odometry.frame_id` names another."""


def heard_path(robot: str, topic: str) -> tuple[str, list[list[float]], Frame]:
    """Wait for the next path on a topic; return its full name, points [m] and their frame.

    Raises:
        Refused: The message holds no path, too many points, or is in an unknown frame.
    """
    listed = call(robot, PARAM_LIST)["parameters"]
    parameters: dict[str, Any] = {each["key"]: each["value"] for each in listed}
    frames = {
        str(parameters["odometry.frame_id"] or ODOMETRY_FRAME): Frame.ODOM,
        str(parameters["command.frame_id"]): Frame.START,
    }
    view = ros_view(robot, None)
    name = view.full_name(topic)
    with view.listen(name, PATH_TYPE, data=True) as listener:
        definition = parse_definition(listener.type_name, listener.definition)
        while not (messages := list(listener.receive(NOTE_S))):
            print(f"robotctl: no path on {printable(name)} yet. Ctrl-C ends", file=sys.stderr)
    points, frame = path_in(definition, base64.b64decode(messages[-1]["data"]), frames, name)
    return name, points, frame


def path_in(
    definition: Definition, data: bytes, frames: Mapping[str, Frame], name: str
) -> tuple[list[list[float]], Frame]:
    """Return points and frame of a serialized path; `frames` says what the names of frames mean.

    Raises:
        Refused: It holds no path, too many points, or is in another frame.
    """
    shown = printable(name)
    if len(data) > MAX_BYTES:
        raise Refused(f"the path on {shown} is too large: it has at most {MAX_POINTS} points")
    try:
        message = decode(definition, data)
    except struct.error:
        raise Refused(f"the message on {shown} cannot be read") from None
    poses = message["poses"]
    if not 2 <= len(poses) <= MAX_POINTS:
        told = f"{len(poses)} point{'' if len(poses) == 1 else 's'}"
        problem = f"the path on {shown} has {told}"
        raise Refused(problem, f"a path has 2 to {MAX_POINTS}")
    frame_id = message["header"]["frame_id"]
    named = {frame_id, *(pose["header"]["frame_id"] or frame_id for pose in poses)}
    if len(named) > 1 or frame_id not in frames:
        told = " and ".join(f"frame {printable(each)!r}" for each in sorted(named)[:2])
        cure = f"publish it in {' or '.join(map(printable, frames))}"
        raise Refused(f"the path on {shown} is in {told}", cure)
    points = []
    for number, pose in enumerate(poses, 1):
        place = pose["pose"]["position"]
        if not (isfinite(place["x"]) and isfinite(place["y"])):
            raise Refused(f"point {number} of the path on {shown} is {place['x']}, {place['y']}")
        points.append([round(place["x"], 4), round(place["y"], 4)])
    return points, frames[frame_id]
