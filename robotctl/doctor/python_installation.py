"""Python, the ROS wheels, and what the shell brings instead of them."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import metadata
from pathlib import Path

from robotctl.doctor.finding import Finding, fault, ok, warning
from robotctl.environment import without_foreign_ros

PINNED = re.compile(r"([A-Za-z0-9._-]+)(?:\[[^]]*\])?==([^; ]+)")
"""A requirement of exactly one version."""

WHEELS_FOR = "x86_64"
"""The machines for which there are wheels; elsewhere ROS comes from a workspace."""


def check_wheels(
    requirements: Iterable[str] | None = None, version_of: Callable[[str], str] = metadata.version
) -> Iterator[Finding]:
    """Compare the installed ROS wheels with the exact versions that robotctl requires.

    `requirements` are those of the installed robotctl, unless given.
    """
    check = "wheels"
    if requirements is None:
        if platform.machine() != WHEELS_FOR:
            yield ok(
                check, f"there are none for {platform.machine()}: ROS is that of the workspace"
            )
            return
        try:
            requirements = metadata.requires("robotctl") or ()
        except metadata.PackageNotFoundError:
            yield ok(check, "robotctl was not installed by pip: its ROS is that of the workspace")
            return
    pinned = [
        match for each in requirements if "extra ==" not in each and (match := PINNED.match(each))
    ]
    wrong = []
    for name, wanted in (match.groups() for match in pinned):
        try:
            found = version_of(name)
        except metadata.PackageNotFoundError:
            wrong.append(f"{name} is missing")
            continue
        if found != wanted:
            wrong.append(f"{name} is {found} and not {wanted}")
    if wrong:
        cure = "install robotctl again in its environment: pip install --force-reinstall ."
        yield fault(check, "; ".join(wrong), cure)
    else:
        told = ", ".join(" ".join(match.groups()) for match in pinned)
        yield ok(check, f"{told}; Python {platform.python_version()}")


def check_shell(environment: Mapping[str, str], prefix: Path) -> Iterator[Finding]:
    """Name another ROS that the shell has sourced before ours, which is below `prefix`."""
    check = "shell"
    paths = {name: value for name, value in environment.items() if name != "RMW_IMPLEMENTATION"}
    _, found = without_foreign_ros(paths, prefix)
    if found:
        yield warning(
            check,
            f"this shell has sourced another ROS, which robotctl avoids: it {found}",
            "start your own programs that use these wheels from a shell without it",
        )
    else:
        yield ok(check, "no other ROS precedes ours")


def check_two_rclpys(folders: Iterable[str]) -> Iterator[Finding]:
    """Name every rclpy after the first in the folders that Python searches for modules."""
    found = {
        (Path(folder) / "rclpy").resolve()
        for folder in folders
        if os.path.isfile(os.path.join(folder, "rclpy", "__init__.py"))  # False if not permitted
    }
    if len(found) > 1:
        yield warning(
            "rclpy",
            f"Python finds {len(found)} of them: {', '.join(sorted(map(str, found)))}",
            "use a virtual environment, or a shell without the other ROS",
        )


def check_pip(prefix: Path, base_prefix: Path, standard_library: Path) -> Iterator[Finding]:
    """Tell where pip would refuse to install, as the distribution owns this Python (PEP 668)."""
    if prefix == base_prefix and (standard_library / "EXTERNALLY-MANAGED").exists():
        yield warning(
            "pip",
            f"{sys.executable} belongs to the distribution: pip install fails in it (PEP 668)",
            "make a virtual environment: python3 -m venv .venv && . .venv/bin/activate",
        )
