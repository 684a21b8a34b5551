"""What is installed and released is what the code needs, and what pyproject.toml says.

The ROS interfaces as they were built: what they promise to programs of other people.
"""

from __future__ import annotations

import ast
import ctypes
import re
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from importlib.metadata import (
    PackageNotFoundError,
    files,
    packages_distributions,
    requires,
    version,
)
from pathlib import Path
from typing import Any

import yaml
from robot_controller.action import DrivePattern
from robot_controller.msg import JournalEntry, RobotStatus
from robot_controller.srv import SetMode

from robotctl import __version__
from robotctl.kernel.modes import Mode
from tests.support.cases import for_each

ROOT = Path(__file__).parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

BUILT_HERE = "robot_controller"
"""The interfaces of msg/, srv/ and action/."""


EXTRAS: list[str] = [
    requirement
    for name, requirements in PROJECT["optional-dependencies"].items()
    if name not in ("test", "dev")
    for requirement in requirements
]
"""What commands need that not every user wants."""


def name_of(requirement: str) -> str:
    """Return the normalized name of the distribution that a requirement asks for."""
    name = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert name is not None, requirement
    return re.sub(r"[-_.]+", "-", name[0]).lower()


def brought_by(distribution: str) -> set[str]:
    """Return the distribution and all that it requires, directly or not."""
    found: set[str] = set()
    waiting = [distribution]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            try:
                waiting += [name_of(requirement) for requirement in requires(name) or ()]
            except PackageNotFoundError:  # an extra that is not installed
                continue
    return found


def imported_modules() -> dict[str, Path]:
    """Return each top-level module that robotctl imports, with one file that does."""
    found: dict[str, Path] = {}
    for path in sorted((ROOT / "robotctl").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [node.module]
            else:
                continue
            found |= {name.split(".")[0]: path for name in names}
    return found


def test_every_import_is_declared_or_comes_with_the_ros_wheels() -> None:
    declared = {name_of(requirement) for requirement in [*PROJECT["dependencies"], *EXTRAS]}
    for name in [name for name in declared if name.startswith("ros-")]:
        declared |= {each for each in brought_by(name) if each.startswith("ros-")}
    provided = packages_distributions()
    for module, path in imported_modules().items():
        if module in sys.stdlib_module_names or module in ("robotctl", BUILT_HERE):
            continue
        providers = {name_of(name) for name in provided.get(module, ())}
        assert providers & declared, f"{path.relative_to(ROOT)} imports {module}: {providers}"


def test_every_dependency_is_imported() -> None:
    provided = packages_distributions()
    used = {name_of(name) for module in imported_modules() for name in provided.get(module, ())}
    declared = {name_of(requirement) for requirement in [*PROJECT["dependencies"], *EXTRAS]}
    assert {name for name in declared - used if not name.startswith("ros-")} == set()


def test_the_hosted_workflow_runs_every_python_that_is_promised() -> None:
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text())
    job = workflow["jobs"]["run"]
    assert job["strategy"]["matrix"]["python"] == promised
    assert ".ci/run" in [step.get("run") for step in job["steps"]]
    lowest, above = re.findall(r"3\.(\d+)", PROJECT["requires-python"])
    assert promised == [f"3.{minor}" for minor in range(int(lowest), int(above))]


def test_the_ros_package_and_the_python_package_have_one_version() -> None:
    package_xml = ElementTree.parse(ROOT / "package.xml")

    assert package_xml.findtext("version") == version("robotctl") == __version__


def test_a_mode_has_the_same_number_in_the_kernel_and_on_the_wire() -> None:
    on_the_wire = {mode: getattr(RobotStatus, f"MODE_{mode.name}") for mode in Mode}

    assert on_the_wire == {mode: mode.value for mode in Mode}


@for_each(
    ("interface", "fields"),
    [
        (
            RobotStatus,
            {
                "robot_name": "string",
                "mode": "uint8",
                "battery_level": "float",
                "cpu_temperature": "float",
                "is_connected": "boolean",
            },
        ),
        (
            JournalEntry,
            {"seq": "uint64", "t_ns": "int64", "kind": "uint8", "name": "string", "data": "string"},
        ),
        (SetMode.Request, {"requested_mode": "uint8"}),
        (
            DrivePattern.Goal,
            {
                "pattern": "string",
                "size": "double",
                "laps": "uint32",
                "speed": "double",
                "replace": "boolean",
            },
        ),
        (
            DrivePattern.Result,
            {
                "completed": "boolean",
                "reason": "string",
                "laps": "uint32",
                "distance": "double",
                "cross_track_rms": "double",
                "cross_track_max": "double",
                "closure": "double",
            },
        ),
        (
            DrivePattern.Feedback,
            {"distance": "double", "lap": "uint32", "cross_track_error": "double"},
        ),
        (SetMode.Response, {"success": "boolean", "message": "string", "current_mode": "uint8"}),
    ],
)
def test_an_interface_keeps_its_fields_since_recordings_hold_them(
    interface: Any, fields: dict[str, str]
) -> None:
    assert interface.get_fields_and_field_types() == fields


@for_each(
    "source",
    [
        "action/DrivePattern.action",
        "msg/JournalEntry.msg",
        "msg/RobotStatus.msg",
        "srv/SetMode.srv",
    ],
)
def test_the_build_is_not_older_than_the_interface_files(source: str) -> None:
    installed = [
        file
        for file in files("robotctl") or []
        if str(file).endswith(f"share/robot_controller/{source}")
    ]

    assert [file.read_text() for file in installed] == [(ROOT / source).read_text()]


@for_each("kind", ["c", "cpp", "fastrtps_c", "fastrtps_cpp"])
def test_programs_in_c_and_cpp_find_the_type_support(kind: str) -> None:
    """rosbag2 loads it for every type whose package is in the ament index."""
    ctypes.CDLL(f"librobot_controller__rosidl_typesupport_{kind}.so")


def test_the_package_names_what_it_imports_and_what_pip_alone_installs() -> None:
    """Messages, rclpy and rosdep keys as dependencies; the rest in a comment, as pip names them."""
    text = (ROOT / "package.xml").read_text()
    named = {
        each.text
        for tag in ("depend", "exec_depend", "buildtool_depend")
        for each in ElementTree.fromstring(text).iter(tag)
    }
    imported = {
        name
        for path in (ROOT / "robotctl").rglob("*.py")
        for name in re.findall(
            r"^ *(?:from|import) (rclpy|ament_index_python|\w+_msgs|\w+_interfaces|std_srvs)\b",
            path.read_text(),
            re.MULTILINE,
        )
    }
    assert imported <= named
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {re.split(r"[\[=<>;]", each)[0] for each in project["dependencies"]}
    as_rosdep = {"Pillow": "python3-pil", "PyYAML": "python3-yaml", "numpy": "python3-numpy"}
    by_pip = {name for name in wanted if not name.startswith("ros-") and name not in as_rosdep}
    pip_only = re.search(r"From pip only[^:]*: ([\w\s-]+) -->", text)
    assert pip_only is not None
    assert set(pip_only[1].split()) == by_pip
    assert {as_rosdep[name] for name in wanted & set(as_rosdep)} <= named


ROSDEP_KEYS = {"python3-numpy", "python3-pil", "python3-pytest", "python3-yaml"}
"""Keys of rosdep (rosdep/python.yaml in github.com/ros/rosdistro).

The test knows this list only, and no test asks rosdep; python3-yaml was looked up in a copy of it.
"""

ROS_PACKAGES = {
    *("action_msgs", "ament_cmake", "ament_cmake_pytest", "ament_cmake_python"),
    *("ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "launch"),
    *("launch_ros", "lifecycle_msgs", "nav_msgs", "rcl_interfaces", "rclpy", "rmw_fastrtps_cpp"),
    *("rosgraph_msgs", "rosidl_default_generators", "rosidl_default_runtime", "sensor_msgs"),
    *("service_msgs", "std_msgs", "std_srvs"),
}
"""Packages of ROS 2 Jazzy, whose names are rosdep keys as well."""


def test_every_dependency_of_the_package_is_a_key_of_rosdep() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    keys = {each.text for each in package.iter() if each.tag.endswith("depend")}
    assert keys <= ROSDEP_KEYS | ROS_PACKAGES


def test_what_the_tests_need_is_a_key_or_named_as_from_pip() -> None:
    text = (ROOT / "package.xml").read_text()
    by_pip = re.findall(r"From pip only: ([\w\s-]+) -->", text)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {re.split(r"[\[=<>;]", each)[0] for each in project["optional-dependencies"]["test"]}
    assert {each for each in needed if not each.startswith("ros-")} <= {
        *by_pip[-1].split(),
        *(key.removeprefix("python3-") for key in ROSDEP_KEYS),
    }
