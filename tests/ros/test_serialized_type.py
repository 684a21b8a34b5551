"""A type for serialized messages is the installed one, and brings neither its class nor numpy."""

from __future__ import annotations

import subprocess
import sys

import pytest
from ament_index_python.resources import get_resource

from robotctl.ros.messages.classes import UnusableType, message_class
from robotctl.ros.playback.playback import serialized_type

OF_RCLPY = (
    *("_TYPE_SUPPORT", "_CREATE_ROS_MESSAGE", "_DESTROY_ROS_MESSAGE"),
    *("_CONVERT_FROM_PY", "_CONVERT_TO_PY"),
)


@pytest.mark.parametrize("package", ["std_msgs", "geometry_msgs", "robot_controller"])
def test_every_message_has_the_type_support_of_its_class(package: str) -> None:
    content, _ = get_resource("rosidl_interfaces", package)
    names = {line.partition(".")[0] for line in content.splitlines() if line.startswith("msg/")}
    assert names
    for name in names:
        generated = message_class(f"{package}/{name}").__class__
        generated.__import_type_support__()
        found = serialized_type(f"{package}/{name}").__class__
        assert [getattr(found, each) for each in OF_RCLPY] == [
            getattr(generated, each) for each in OF_RCLPY
        ]


def test_it_imports_no_numpy() -> None:
    program = (
        "import sys; from robotctl.ros.playback.playback import serialized_type; "
        "serialized_type('nav_msgs/msg/Odometry'); print('numpy' in sys.modules)"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ran.stdout == "False\n", ran.stderr


def test_an_event_of_a_service_has_its_class() -> None:
    name = "std_srvs/srv/SetBool_Event"
    assert serialized_type(name) is message_class(name)


@pytest.mark.parametrize("name", ["std_msgs/msg/Strings", "os/msg/Path", "std_msgs/String"])
def test_a_type_that_is_not_installed_is_refused(name: str) -> None:
    with pytest.raises(UnusableType):
        serialized_type(name)
