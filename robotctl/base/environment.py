"""Makes Python import our rclpy in a shell that sourced another ROS. Standard library only."""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Callable, Mapping
from pathlib import Path

DISTRO = "jazzy"
RMW = "rmw_fastrtps_cpp"

_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""The variables in which Fast DDS 2 and 3 look for a profiles file."""

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"

_NOTE = "_ROBOTCTL_ENVIRONMENT_NOTE"
_WHEELS_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""The variable that keeps the ROS wheels from extending LD_LIBRARY_PATH when Python starts."""

_PREFIXES, _PACKAGES, _LIBRARIES = "AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"

_MARKS = {
    _PACKAGES: ("rclpy/__init__.py",),
    _LIBRARIES: ("librcl.so",),
    _PREFIXES: ("share/rclpy", "lib/librcl.so"),
}
"""Files of a folder that would replace our rclpy, by variable."""


def prepare(before_restart: Callable[[], object] = lambda: None) -> str:
    """Prepare the environment for the import of rclpy, and return a note after a restart, else "".

    To remove another ROS or middleware, the process restarts, after a call of `before_restart`.
    Discovery is limited to this machine, unless the user has chosen otherwise.
    """
    note = os.environ.pop(_NOTE, "")
    if _has_own_rclpy():
        cleaned, found = without_foreign_ros(os.environ, Path(sys.prefix))
        if found and not note:  # only once, even if the entries come back
            before_restart()  # the loader reads LD_LIBRARY_PATH only when a process starts
            os.execve(sys.executable, sys.orig_argv, {**cleaned, _NOTE: found})
        prefixes = _entries(os.environ, _PREFIXES)
        if sys.prefix not in prefixes:
            os.environ[_PREFIXES] = os.pathsep.join([*prefixes, sys.prefix])
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # no idle threads of numpy: 60 ms of CPU
    limit_discovery()
    if not any(variable in os.environ for variable in _PROFILES):
        os.environ[_PROFILES[0]] = str(Path(__file__).parents[1] / "ros" / "fastdds.xml")
    return note


def without_foreign_ros(environment: Mapping[str, str], prefix: Path) -> tuple[dict[str, str], str]:
    """Return a copy of `environment` without any ROS outside `prefix`, and a note on the changes.

    Folders of our own distribution stay unless they have an rclpy or librcl. RMW_IMPLEMENTATION is
    set to rmw_fastrtps_cpp, the only middleware of robotctl, if it names another.
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


def limit_discovery() -> None:
    """Limit discovery to this machine, unless the user has chosen otherwise."""
    if os.environ.pop("ROS_LOCALHOST_ONLY", "") == "1":  # of Humble: rcl would warn about it
        os.environ[RANGE] = "LOCALHOST"
        os.environ.pop("ROS_STATIC_PEERS", None)
    os.environ.setdefault(RANGE, "LOCALHOST")


def _has_own_rclpy() -> bool:
    """Return whether our environment has an rclpy, unlike a build in a ROS workspace."""
    return any(
        (Path(sysconfig.get_path(name)) / "rclpy" / "__init__.py").exists()
        for name in ("purelib", "platlib")
    )


def _entries(environment: Mapping[str, str], variable: str) -> list[str]:
    return [entry for entry in environment.get(variable, "").split(os.pathsep) if entry]


def _is_marked(entry: str, variable: str) -> bool:
    # os.path.exists returns False for a folder without permission; Path.exists would raise.
    return any(os.path.exists(os.path.join(entry, mark)) for mark in _MARKS[variable])


def _is_below(entry: str, folders: list[Path]) -> bool:
    """Return whether the entry is in one of the folders, as written or after resolving links."""
    return any(
        Path(entry).is_relative_to(folder) or Path(entry).resolve().is_relative_to(folder.resolve())
        for folder in folders
    )
