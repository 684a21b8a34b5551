"""The points of a `nav_msgs/Path`; what cannot be driven is named."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest

from robotctl.base.errors import Refused
from robotctl.cli.commands.drive.paths import PATH_TYPE, path_in
from robotctl.kernel.course import MAX_POINTS, Frame
from robotctl.messages.definition import parse_definition
from robotctl.messages.values import encode

FRAMES = {"odom": Frame.ODOM, "base_link": Frame.START}

TEXT = """std_msgs/Header header
geometry_msgs/PoseStamped[] poses
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/PoseStamped
std_msgs/Header header
geometry_msgs/Pose pose
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
DEFINITION = parse_definition(PATH_TYPE, TEXT)


def header(frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": frame}


def message(points: list[tuple[float, float]], frame: str = "odom", each: str = "") -> bytes:
    turned = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    poses = [
        {
            "header": header(each),
            "pose": {"position": {"x": x, "y": y, "z": 0.0}, "orientation": turned},
        }
        for x, y in points
    ]
    return encode(DEFINITION, {"header": header(frame), "poses": poses})


@pytest.mark.parametrize(("frame", "meant"), [("odom", Frame.ODOM), ("base_link", Frame.START)])
def test_the_points_are_those_of_the_poses_in_their_frame(frame: str, meant: Frame) -> None:
    data = message([(0.0, 0.0), (1.00004, -2.5)], frame, each=frame)
    assert path_in(DEFINITION, data, FRAMES, "/plan") == ([[0.0, 0.0], [1.0, -2.5]], meant)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (message([(0.0, 0.0)]), "has 1 point: a path has 2 to 2000"),
        (message([]), "has 0 points"),
        (message([(float(n), 0.0) for n in range(MAX_POINTS + 1)]), "has 2001 points"),
        (bytes(1_000_000 * 100), "too large: it has at most 2000 points"),
        (message([(0.0, 0.0), (nan, 1.0)]), "point 2 of the path on /plan is nan, 1.0"),
        (message([(0.0, 0.0), (1.0, inf)]), "point 2 of"),
        (message([(0.0, 0.0), (1.0, 0.0)], "map"), "in frame 'map': publish it in odom or base_"),
        (message([(0.0, 0.0), (1.0, 0.0)], ""), "is in frame ''"),
        (message([(0.0, 0.0), (1.0, 0.0)], "odom", "map"), "in frame 'map' and frame 'odom'"),
        (message([(0.0, 0.0), (1.0, 0.0)])[:-9], "cannot be read"),
        (b"", "cannot be read"),
    ],
)
def test_what_cannot_be_driven_is_named(data: bytes, said: str) -> None:
    with pytest.raises(Refused) as refused:
        path_in(DEFINITION, data, FRAMES, "/plan")
    assert said in str(refused.value)
