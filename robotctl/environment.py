"""Makes ours the rclpy that is imported, whatever ROS the shell has sourced.

A sourced ROS comes before the environment that robotctl is installed in: its Python packages by
PYTHONPATH, its libraries by LD_LIBRARY_PATH, which the loader reads once, when a process starts.
So those entries are dropped and the process starts again. Standard library only.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path

DISTRO = "jazzy"
RMW = "rmw_fastrtps_cpp"

_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Where Fast DDS 2 and 3 look for what its own defaults do not suit."""

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"

_NOTE = "_ROBOTCTL_ENVIRONMENT_NOTE"
_WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Without it the ROS wheels put their libraries on LD_LIBRARY_PATH when Python starts."""

_PREFIXES, _PACKAGES, _LIBRARIES = "AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"

_MARKS = {
    _PACKAGES: ("rclpy/__init__.py",),
    _LIBRARIES: ("librcl.so",),
    _PREFIXES: ("share/rclpy", "lib/librcl.so"),
}
"""By what a folder on each of these paths would take the place of our rclpy."""


def prepare(before_restart: Callable[[], object] = lambda: None) -> str:
    """Call this before rclpy is imported; returns what was left out, in a sentence, or "".

    Where a foreign ROS is in the way, the process restarts itself without it, after a call of
    `before_restart`, and this returns in the new one. Also limits discovery to this machine, and
    announces this process more often, unless the user chose otherwise, and names his home.
    """
    note = os.environ.pop(_NOTE, "")
    if _has_own_rclpy():
        cleaned, found = without_foreign_ros(os.environ, Path(sys.prefix))
        if found and not note:  # once at most, whatever comes back
            before_restart()
            os.execve(sys.executable, sys.orig_argv, {**cleaned, _NOTE: found})
        prefixes = _entries(os.environ, _PREFIXES)
        if sys.prefix not in prefixes:
            os.environ[_PREFIXES] = os.pathsep.join([*prefixes, sys.prefix])
    _limit_discovery()
    if not any(variable in os.environ for variable in _PROFILES):
        os.environ[_PROFILES[0]] = str(Path(__file__).with_name("ros") / "fastdds.xml")
    return note


def without_foreign_ros(environment: Mapping[str, str], prefix: Path) -> tuple[dict[str, str], str]:
    """The environment for processes whose own ROS is below `prefix`, and what was left out.

    Of a sourced ROS of our distribution only what holds another rclpy is foreign; the message
    packages of overlays stay. Of any other distribution everything is.
    """
    distro = environment.get("ROS_DISTRO", "")
    cleaned = dict(environment)
    foreign = [
        Path(entry)
        for entry in _entries(environment, _PREFIXES)
        if not _is_below(entry, [prefix])
        and (distro not in ("", DISTRO) or _is_marked(entry, _PREFIXES))
    ]
    touched = []
    for variable in (_PACKAGES, _LIBRARIES, _PREFIXES):
        entries = _entries(environment, variable)
        kept = [
            entry
            for entry in entries
            if _is_below(entry, [prefix])
            or not (_is_marked(entry, variable) or _is_below(entry, foreign))
        ]
        if kept != entries:
            touched.append(variable)
            cleaned[variable] = os.pathsep.join(kept)
            if not kept:
                del cleaned[variable]
    said = []
    if touched:
        cleaned.pop("ROS_DISTRO", None)
        cleaned.pop(_WHEELS_GUARD, None)
        name = f" ({distro})" if distro else ""
        said.append(f"dropped another ROS{name} from {', '.join(touched)}")
    rmw = environment.get("RMW_IMPLEMENTATION", "")
    if rmw not in ("", RMW):
        cleaned["RMW_IMPLEMENTATION"] = RMW
        said.append(f"replaced {rmw} by {RMW}, the only middleware that robotctl brings")
    return cleaned, "; ".join(said)


def _limit_discovery() -> None:
    """To this machine, unless the user chose otherwise; also where he did so in Humble's words.

    rcl still obeys ROS_LOCALHOST_ONLY before all else, but warns of it in every process.
    """
    if os.environ.pop("ROS_LOCALHOST_ONLY", "") == "1":
        os.environ[_RANGE] = "LOCALHOST"
        os.environ.pop("ROS_STATIC_PEERS", None)
    os.environ.setdefault(_RANGE, "LOCALHOST")


def _has_own_rclpy() -> bool:
    """Whether our environment has an rclpy; built in a ROS workspace, it uses the sourced one."""
    return any(
        (Path(sysconfig.get_path(name)) / "rclpy" / "__init__.py").exists()
        for name in ("purelib", "platlib")
    )


def _entries(environment: Mapping[str, str], variable: str) -> list[str]:
    return [entry for entry in environment.get(variable, "").split(os.pathsep) if entry]


def _is_marked(entry: str, variable: str) -> bool:
    return any((Path(entry) / mark).exists() for mark in _MARKS[variable])


def _is_below(entry: str, folders: list[Path]) -> bool:
    """Whether the entry lies in one of the folders, as it is written or behind links."""
    return any(
        Path(entry).is_relative_to(folder) or Path(entry).resolve().is_relative_to(folder.resolve())
        for folder in folders
    )
