"""What a package needs: declared in package.xml, and not brought a second time by pip."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from robotctl.doctor.finding import Finding, fault
from robotctl.doctor.package.constants import keyword, texts_within
from robotctl.doctor.package.package_files import Package, read_text

ROS_MODULES = frozenset(
    """
    ament_index_python cv_bridge image_geometry launch launch_ros message_filters rclpy
    rosbag2_py tf2_geometry_msgs tf2_py tf2_ros
    """.split()  # noqa: SIM905 - a list of thirteen strings has thirteen lines
)
ROS_SUFFIXES = ("_msgs", "_srvs", "_interfaces")

FROM_PIP = re.compile(r"\s*(?:ros-\w+-)?(rclpy|[a-z0-9]+[_-](?:msgs|srvs|interfaces))\b")
"""A requirement by which pip brings modules of ROS."""

SHELL_FILES = (".sh", ".bash")
PIP_INSTALL = re.compile(r"^(?!\s*#).*\b(?:pip3?|python3? -m pip) install\b", re.MULTILINE)
ENVIRONMENT = re.compile(r"\bvenv\b|virtualenv|conda|bin/activate|pipx|--target")
OWNED_PYTHON = re.compile(r"^FROM\s+\S*(?:ubuntu|debian|ros)\b", re.MULTILINE | re.IGNORECASE)


def check_depends(package: Package) -> Iterator[Finding]:
    """Each module of ROS that is imported stands in package.xml."""
    own = {package.name, *(path.parts[0].removesuffix(".py") for path in package.modules)}
    told: set[str] = set()
    for path, tree in package.modules.items():
        for name, line in _imported(tree):
            is_ros = name in ROS_MODULES or name.endswith(ROS_SUFFIXES)
            if is_ros and name not in {*package.depends, *own, *told}:
                told.add(name)
                yield fault(
                    "depend",
                    f"{path}:{line} imports {name}, which package.xml does not name",
                    f"add <exec_depend>{name}</exec_depend>; it fails on another computer",
                )


def check_two_rclpys(package: Package) -> Iterator[Finding]:
    """Nothing in the package brings or hides the modules of ROS."""
    check = "two rclpys"
    cure = "leave it out: ROS brings it, and package.xml names it"
    given = None if package.setup is None else keyword(package.setup.call, "install_requires")
    names = {} if package.setup is None else package.setup.names
    required = [] if given is None else list(texts_within(given, names))
    for place, lines in (("setup.py", required), ("requirements.txt", _requirements(package))):
        for line in lines:
            if match := FROM_PIP.match(line):
                text = f"{place} lets pip bring {match[1]} beside the one of ROS"
                yield fault(check, text, cure)
    for path in package.modules:
        is_module = len(path.parts) == 1 or path.parts[1:] == ("__init__.py",)
        name = path.parts[0].removesuffix(".py")
        is_ros = name in ROS_MODULES or name.endswith(ROS_SUFFIXES)
        if is_module and is_ros and name != package.name:
            yield fault(check, f"{path} hides the module {name} of ROS", "rename it")


def check_pep_668(package: Package) -> Iterator[Finding]:
    """No script of the package installs into a Python that belongs to the distribution."""
    for path in package.files:
        is_image = path.name.startswith(("Dockerfile", "Containerfile"))
        if not is_image and path.suffix not in SHELL_FILES:
            continue
        try:
            text = read_text(package.folder / path)
        except OSError:
            continue
        found = PIP_INSTALL.search(text)
        if not found or ENVIRONMENT.search(text) or (is_image and not OWNED_PYTHON.search(text)):
            continue
        line = text.count("\n", 0, found.end()) + 1
        yield fault(
            "PEP 668",
            f"{path}:{line} lets pip install into the Python of the distribution, which refuses it",
            "make a virtual environment first: python3 -m venv --system-site-packages .venv",
        )


def _imported(tree: ast.Module) -> Iterator[tuple[str, int]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name.split(".")[0], node.lineno
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.split(".")[0], node.lineno


def _requirements(package: Package) -> list[str]:
    place = Path("requirements.txt")
    if place not in package.files:
        return []
    try:
        return read_text(package.folder / place).splitlines()
    except OSError:
        return []
