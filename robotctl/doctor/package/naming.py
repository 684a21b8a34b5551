"""Names: dashes where ROS or Python allow none, and names that are used twice."""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from robotctl.doctor.finding import Finding, fault
from robotctl.doctor.package.constants import called, calls, keyword, text_of
from robotctl.doctor.package.installing import entry_points
from robotctl.doctor.package.package_files import Package

_PACKAGE_NAME = re.compile(r"[a-z][a-z0-9_]*")
_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TOPIC_NAME = re.compile(r"[~/]?[A-Za-z0-9_/~{}]*")

NAMED_ENTITIES = ("create_publisher", "create_subscription", "create_service", "create_client")
"""Calls whose name of a topic or service stands at their first or second place."""

KNOWN_PACKAGES = frozenset(
    """
    ament_index_python geometry_msgs launch launch_ros nav_msgs rcl_interfaces rclpy
    sensor_msgs std_msgs std_srvs test tests tf2_ros
    """.split()  # noqa: SIM905 - a list of thirteen strings has thirteen lines
)
"""Names that a package of ROS or of Python has already."""

GROUPS = ("GroupAction", "PushRosNamespace", "PushROSNamespace")
"""Calls in a launch file that put nodes into namespaces."""

_TARGET_TWICE = re.compile(r"ament_python_install_package\s*\(\s*(\$\{PROJECT_NAME\}|\w+)")


def check_dashes(package: Package) -> Iterator[Finding]:
    """Names have no dashes: those of packages, modules, nodes, topics and keys of setup.cfg."""
    check = "dashes"
    if not _PACKAGE_NAME.fullmatch(package.name):
        good = re.sub(r"\W+", "_", package.name.lower()) or "a_name"
        yield fault(
            check,
            f"package.xml: ROS allows no package named {package.name!r}",
            f"use small letters, digits and underscores: {good}",
        )
    for section, key in package.config:
        if section in ("develop", "install") and "-" in key:
            yield fault(
                check,
                f"setup.cfg: setuptools no longer reads {key}, so ros2 run finds no executable",
                f"write {key.replace('-', '_')}",
            )
    for path in package.modules:
        if path.parts[0] == package.name and "-" in str(path):
            text = f"{path}: Python cannot import a name with a dash"
            yield fault(check, text, f"rename it to {path.name.replace('-', '_')}")
    for path, tree in package.ros_modules.items():
        for name, line in _node_names(tree):
            if not _NODE_NAME.fullmatch(name):
                text = f"{path}:{line}: ROS allows no node named {name!r}"
                yield fault(check, text, "use letters, digits and underscores")
        for name, line in _entity_names(tree):
            if not _TOPIC_NAME.fullmatch(name):
                text = f"{path}:{line}: ROS allows no topic or service named {name!r}"
                yield fault(check, text, "use letters, digits, underscores and slashes")


def check_collisions(package: Package, all_names: Sequence[str]) -> Iterator[Finding]:
    """No name is used twice; `all_names` are those of all packages of the workspace."""
    check = "name collisions"
    if package.name in KNOWN_PACKAGES or package.name in sys.stdlib_module_names:
        yield fault(
            check,
            f"a package named {package.name} hides the one of ROS or Python that has this name",
            f"rename it, for example to my_{package.name}",
        )
    if all_names.count(package.name) > 1:
        text = f"{all_names.count(package.name)} packages of the workspace are named {package.name}"
        yield fault(check, text, "rename one, or put a COLCON_IGNORE into its folder")
    points = list(entry_points(package))
    for name, count in Counter(name for name, _, _ in points).items():
        if count > 1:
            yield fault(
                check,
                f"setup.py: {count} executables are named {name}, and one remains",
                "give each its own name",
            )
    for path, tree in package.modules.items():
        for name, count in Counter(_launched(package, tree)).items():
            if count > 1:
                yield fault(
                    check,
                    f"{path} starts {count} nodes named {name}: ROS mixes them up",
                    "give each its own name=, or its own namespace=",
                )
    for name in _TARGET_TWICE.findall(package.cmake):
        same = name in ("${PROJECT_NAME}", package.name)
        if same and "rosidl_generate_interfaces" in package.cmake:
            yield fault(
                check,
                f"CMakeLists.txt installs a Python package named {package.name}, "
                "as the one that is generated for its interfaces",
                f"move the interfaces into a package {package.name}_interfaces",
            )


def _launched(package: Package, tree: ast.Module) -> Iterator[str]:
    """Yield the names of the nodes that a launch file starts together in one namespace."""
    if any(called(call) in GROUPS for call in calls(tree)):
        return
    modules = {name: module for name, module, _ in entry_points(package)}
    for call in calls(tree):
        executable = text_of(keyword(call, "executable"), {})
        if called(call) != "Node" or keyword(call, "namespace") or keyword(call, "condition"):
            continue
        if keyword(call, "name") is not None:
            name = text_of(keyword(call, "name"), {})
        elif text_of(keyword(call, "package"), {}) == package.name and executable in modules:
            path = Path(*modules[executable].split(".")).with_suffix(".py")
            names = [each for each, _ in _node_names(package.modules.get(path, ast.Module([], [])))]
            name = names[0] if len(names) == 1 else None
        else:
            name = None
        if name is not None:
            yield name


def _node_names(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield the names that nodes get in the code, with their lines."""
    nodes = {
        each
        for each in ast.walk(tree)
        if isinstance(each, ast.ClassDef)
        and any("Node" in ast.unparse(base) for base in each.bases)
    }
    for within in nodes:
        for call in calls(within):
            is_super = isinstance(call.func, ast.Attribute) and ast.unparse(call.func.value) in (
                "super()",
                "Node",
            )
            if is_super and called(call) == "__init__":
                yield from _constant(call, 0, "node_name")
    for call in calls(tree):
        if called(call) in ("Node", "create_node") and not keyword(call, "executable"):
            yield from _constant(call, 0, "node_name")


def _entity_names(tree: ast.Module) -> Iterator[tuple[str, int]]:
    for call in calls(tree):
        if called(call) in NAMED_ENTITIES:
            is_topic = called(call) in NAMED_ENTITIES[:2]
            yield from _constant(call, 1, "topic" if is_topic else "srv_name")


def _constant(call: ast.Call, place: int, name: str) -> Iterator[tuple[str, int]]:
    given = call.args[place] if len(call.args) > place else keyword(call, name)
    text = text_of(given, {})
    if text is not None:
        yield text, call.lineno
