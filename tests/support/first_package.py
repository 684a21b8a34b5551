"""A healthy first ROS 2 package in a workspace, and each classic mistake as one edit of it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

PACKAGE_XML = """\
<?xml version="1.0"?>
<package format="3">
  <name>my_robot</name>
  <version>0.0.0</version>
  <description>A first package</description>
  <maintainer email="ada@example.com">ada</maintainer>
  <license>Apache-2.0</license>
  <depend>rclpy</depend>
  <exec_depend>std_msgs</exec_depend>
  <exec_depend>sensor_msgs</exec_depend>
  <exec_depend>std_srvs</exec_depend>
  <exec_depend>launch</exec_depend>
  <exec_depend>launch_ros</exec_depend>
  <export><build_type>ament_python</build_type></export>
</package>
"""

SETUP_PY = """\
import os
from glob import glob

from setuptools import find_packages, setup

package_name = 'my_robot'

setup(
    name=package_name,
    version='0.0.0',
    packages=find_packages(exclude=['test']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + package_name]),
        ('share/' + package_name, ['package.xml']),
        (os.path.join('share', package_name, 'launch'), glob('launch/*.launch.py')),
        (os.path.join('share', package_name, 'config'), glob('config/*.yaml')),
    ],
    install_requires=['setuptools'],
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'talker = my_robot.talker:main',
            f'listener = {package_name}.listener:main',
        ],
    },
)
"""

SETUP_CFG = """\
[develop]
script_dir=$base/lib/my_robot
[install]
install_scripts=$base/lib/my_robot
"""

TALKER = """\
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String
from std_srvs.srv import Trigger


class Talker(Node):
    def __init__(self):
        super().__init__('talker')
        self.scans = self.create_publisher(LaserScan, 'scan', qos_profile_sensor_data)
        self.words = self.create_publisher(String, '/chatter', 10)
        self.client = self.create_client(Trigger, 'reset')
        self.create_timer(0.5, self.tick)

    def tick(self):
        self.words.publish(String(data='hello'))
        future = self.client.call_async(Trigger.Request())
        future.add_done_callback(self.done)

    def done(self, future):
        self.get_logger().info(str(future.result()))


def main(args=None):
    rclpy.init(args=args)
    node = Talker()
    node.client.wait_for_service()
    rclpy.spin_until_future_complete(node, node.client.call_async(Trigger.Request()))
    rclpy.spin(node)
    rclpy.shutdown()
"""

LISTENER = """\
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String


class Listener(Node):
    def __init__(self):
        super().__init__('listener')
        qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(LaserScan, '/scan', self.scan_callback, qos)
        self.create_subscription(String, 'chatter', self.heard, 10)

    def scan_callback(self, message):
        pass

    def heard(self, message):
        self.get_logger().info(message.data)


def main():
    rclpy.init()
    rclpy.spin(Listener())
    rclpy.shutdown()
"""

LAUNCH = """\
from launch import LaunchDescription
from launch_ros.actions import Node


def generate_launch_description():
    return LaunchDescription([
        Node(package='my_robot', executable='talker'),
        Node(package='my_robot', executable='talker', namespace='two'),
        Node(package='my_robot', executable='listener', name='ear'),
        Node(package='other', executable='talker'),
    ])
"""

INSTALLER = """\
#!/bin/sh
python3 -m venv --system-site-packages .venv && . .venv/bin/activate
pip install numpy
"""

TOOLS_CMAKE = """\
cmake_minimum_required(VERSION 3.8)
project(my_tools)
find_package(ament_cmake REQUIRED)
# install(PROGRAMS scripts/old.py DESTINATION lib/${PROJECT_NAME})
install(PROGRAMS scripts/calibrate.py DESTINATION lib/${PROJECT_NAME})
ament_package()
"""


def healthy(workspace: Path) -> Path:
    """Write the workspace, with a package of each build type; return the Python one's folder."""
    package = workspace / "src" / "my_robot"
    files = {
        "package.xml": PACKAGE_XML,
        "setup.py": SETUP_PY,
        "setup.cfg": SETUP_CFG,
        "resource/my_robot": "",
        "my_robot/__init__.py": "",
        "my_robot/talker.py": TALKER,
        "my_robot/listener.py": LISTENER,
        "launch/my_robot.launch.py": LAUNCH,
        "config/robot.yaml": "{}\n",
        "install.sh": INSTALLER,
        "requirements.txt": "numpy\n",
        "test/test_it.py": "import unheard_of_msgs\n",
        "../my_tools/package.xml": PACKAGE_XML.replace("my_robot", "my_tools").replace(
            "ament_python", "ament_cmake"
        ),
        "../my_tools/CMakeLists.txt": TOOLS_CMAKE,
        "../my_tools/scripts/calibrate.py": "#!/usr/bin/env python3\n",
    }
    for name, text in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)
    (workspace / "src" / "my_tools" / "scripts" / "calibrate.py").chmod(0o755)
    return package


def _edit(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(package: Path) -> None:
        text = (package / name).read_text()
        assert old in text
        (package / name).write_text(text.replace(old, new))

    return edit


def _write(name: str, text: str = "") -> Callable[[Path], None]:
    def write(package: Path) -> None:
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(text)

    return write


def _rename(package: Path) -> None:
    for name in ("package.xml", "setup.py", "setup.cfg"):
        text = re.sub(r"my_robot(?!\.)", "my-robot", (package / name).read_text())
        (package / name).write_text(text)
    os.rename(package / "resource" / "my_robot", package / "resource" / "my-robot")


def _build(package: Path) -> None:
    setup = package.parents[1] / "install" / "local_setup.bash"
    setup.parent.mkdir()
    setup.touch()


def _unexecutable(package: Path) -> None:
    (package.parent / "my_tools" / "scripts" / "calibrate.py").chmod(0o644)


SPIN = "rclpy.spin_until_future_complete(self, self.client.call_async(Trigger.Request()))"

MISTAKES: dict[str, tuple[str, Callable[[Path], None]]] = {
    "an entry point that names no function": (
        "entry points",
        _edit("setup.py", "talker:main", "talker:run"),
    ),
    "an entry point that names no module": (
        "entry points",
        _edit("setup.py", "my_robot.talker", "my_robot.talkers"),
    ),
    "a node without an entry point": (
        "entry points",
        _edit("setup.py", "'talker = my_robot.talker:main',", ""),
    ),
    "no setup.cfg": ("entry points", lambda package: (package / "setup.cfg").unlink()),
    "launch files that are not installed": (
        "data_files",
        _edit("setup.py", "(os.path.join('share', package_name, 'launch'), glob('launch/*", "#"),
    ),
    "no marker of the package": (
        "data_files",
        lambda package: (package / "resource" / "my_robot").unlink(),
    ),
    "built and not sourced": ("not sourced", _build),
    "a package with a dash": ("dashes", _rename),
    "setup.cfg with dashes": ("dashes", _edit("setup.cfg", "script_dir", "script-dir")),
    "a node with a dash": ("dashes", _edit("my_robot/talker.py", "'talker'", "'my-talker'")),
    "a topic with a dash": ("dashes", _edit("my_robot/talker.py", "'/chatter'", "'/my-chatter'")),
    "interfaces in a Python package": ("interfaces", _write("msg/Wheel.msg", "float64 speed\n")),
    "a missing depend": (
        "depend",
        _edit("package.xml", "<exec_depend>sensor_msgs</exec_depend>", ""),
    ),
    "a program that may not be executed": ("executable bit", _unexecutable),
    "a program without its interpreter": (
        "executable bit",
        _write("../my_tools/scripts/calibrate.py", "import rclpy\n"),
    ),
    "a sensor heard reliably": ("QoS", _edit("my_robot/listener.py", ".BEST_EFFORT", ".RELIABLE")),
    "a publisher that latches nothing": (
        "QoS",
        _edit(
            "my_robot/listener.py",
            "self.heard, 10",
            "self.heard, QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)",
        ),
    ),
    "rclpy from pip": ("two rclpys", _edit("setup.py", "['setuptools']", "['rclpy']")),
    "messages from pip": ("two rclpys", _write("requirements.txt", "ros-humble-std-msgs\n")),
    "a module that hides one of ROS": ("two rclpys", _write("std_msgs/__init__.py")),
    "pip into the system": ("PEP 668", _write("install.sh", "#!/bin/sh\nsudo pip install numpy\n")),
    "pip into an image of ROS": (
        "PEP 668",
        _write("Dockerfile", "FROM ros:jazzy\nRUN pip3 install numpy\n"),
    ),
    "a timer that spins": (
        "spin in a callback",
        _edit(
            "my_robot/talker.py", "future = self.client", f"{SPIN}\n        future = self.client"
        ),
    ),
    "a callback whose helper spins": (
        "spin in a callback",
        _edit(
            "my_robot/listener.py",
            "        pass\n",
            "        self.wait()\n\n    def wait(self):\n        rclpy.spin_once(self)\n",
        ),
    ),
    "a callback that waits for a service": (
        "spin in a callback",
        _edit(
            "my_robot/talker.py",
            "self.client.call_async(Trigger.Request())\n        future.",
            "self.client.call(Trigger.Request())\n        future.",
        ),
    ),
    "two nodes of one name": (
        "name collisions",
        _edit("launch/my_robot.launch.py", "'ear'", "'talker'"),
    ),
    "one node that is started twice": (
        "name collisions",
        _edit(
            "launch/my_robot.launch.py",
            "executable='talker', namespace='two'",
            "executable='talker'",
        ),
    ),
    "two executables of one name": (
        "name collisions",
        _edit("setup.py", "f'listener =", "f'talker ="),
    ),
    "two packages of one name": (
        "name collisions",
        _edit("../my_tools/package.xml", "my_tools", "my_robot"),
    ),
    "generated and own Python under one name": (
        "name collisions",
        _edit(
            "../my_tools/CMakeLists.txt",
            "ament_package()",
            "rosidl_generate_interfaces(${PROJECT_NAME})\n"
            "ament_python_install_package(${PROJECT_NAME})\nament_package()",
        ),
    ),
}
"""Mistake -> the check that names it, and the edit that makes it, of the Python package."""
