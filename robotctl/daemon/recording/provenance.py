"""The versions of the software that makes a recording."""

from __future__ import annotations

import hashlib
import os
import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from pwd import getpwuid
from typing import Final

import robotctl
from robotctl.base.environment import DISTRO, RMW
from robotctl.base.files import open_regular

MAX_GIT_BYTES: Final = 4 << 20
"""A larger file of git is not read."""

WHEELS: Final = {
    "rclpy": "ros-jazzy-rclpy",  # the package `rclpy` in it has the version before the last patch
    "rcl": "ros-rcl",
    "rmw_fastrtps": "ros-rmw-fastrtps-cpp",
    "fastdds": "ros-fastrtps",
    "common_interfaces": "ros-jazzy-common-interfaces",
    "mcap": "mcap",
    "msgspec": "msgspec",
    "zstandard": "zstandard",
    "isal": "isal",
    "numpy": "numpy",
}
"""The wheel whose version is recorded for each library."""

_REVISION = re.compile(r"[0-9a-f]{40}(?:[0-9a-f]{24})?")


def provenance() -> dict[str, str]:
    """Return known versions, host, user and git commits (of robotctl and the working folder)."""
    try:
        return dict(_provenance(Path.cwd()))
    except OSError:  # the working folder was removed
        return dict(_provenance(None))


@cache
def _provenance(directory: Path | None) -> Mapping[str, str]:
    """Return the values of `provenance`, read before an update can replace the files."""
    known = {
        "robotctl": robotctl.__version__,
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()).strip(),
        "ros_distro": DISTRO,
        "rmw": RMW,
        **{name: _version(wheel) or _version(name) for name, wheel in WHEELS.items()},
        "host": os.uname().nodename,
        "machine": f"{os.uname().machine}, Linux {os.uname().release}",
        "user": user(),
        "directory": "" if directory is None else str(directory),
        "git.robotctl": revision(Path(robotctl.__file__).parents[1]),
        "git.directory": "" if directory is None else revision_around(directory),
    }
    return {name: value for name, value in known.items() if value}


def user() -> str:
    """Return login name and uid of the user of this process."""
    uid = os.getuid()
    try:
        return f"{getpwuid(uid).pw_name} (uid {uid})"
    except KeyError:  # a container without this user
        return f"uid {uid}"


def revision_around(folder: Path) -> str:
    """Return the commit of the repository that contains `folder`, "" if there is none."""
    return next(filter(None, map(revision, (folder, *folder.parents))), "")


def revision(folder: Path) -> str:
    """Return the commit that is checked out in `folder`, "" if it is not a repository's root."""
    try:
        git = folder / ".git"  # read here: the git command may take seconds or hang
        if git.is_file():  # of a worktree or submodule
            git = folder / _text(git).removeprefix("gitdir: ")
        head = _text(git / "HEAD")
        name = head.removeprefix("ref: ")
        candidates = [head] if name == head else _values(git, name)
        return next(filter(_REVISION.fullmatch, candidates), "")
    except (OSError, ValueError):
        return ""


def _values(git: Path, name: str) -> Iterator[str]:
    """Yield the texts in git's files for the reference `name`, not all of them hashes."""
    common = git / "commondir"
    for place in (git, git / _text(common)) if common.exists() else (git,):
        if (place / name).is_file():
            yield _text(place / name)
        if (place / "packed-refs").is_file():
            for line in _text(place / "packed-refs").splitlines():
                commit, _, reference = line.partition(" ")
                if reference == name:
                    yield commit


def _text(path: Path) -> str:
    """Return the UTF-8 text of a small regular file, or raise OSError or ValueError."""
    with open_regular(path) as file:
        content = file.read(MAX_GIT_BYTES + 1)
    if len(content) > MAX_GIT_BYTES:
        raise ValueError(f"{path} is larger than {MAX_GIT_BYTES} bytes")
    return content.decode().strip()


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


CONTROL_PATH: Final = ("config/", "daemon/", "ipc/", "kernel/", "messages/", "ros/", "sim.py")
"""The modules and folders whose code computes velocity commands."""

ASIDE: Final = ("ros/executables", "ros/exchange.py", "ros/playback.py", "ros/queries.py")
"""Modules and folders within CONTROL_PATH that no daemon imports."""

DIGEST: Final = "digest"
"""The key of the digest over all modules."""

SHORT_CHARACTERS: Final = 16
"""Length of a module's short hash."""


@cache
def software(package: Path = Path(robotctl.__file__).parent) -> dict[str, str]:
    """Return a short SHA-256 of each module that computes velocity commands, by module path.

    The key DIGEST has one hash of all: the SHA-256 of the lines that sha256sum(1) prints for them,
    sorted by path. The files are read only once.
    """
    hashes = dict(_hashes(package))
    lines = "".join(f"{value}  {name}\n" for name, value in sorted(hashes.items()))
    digest = hashlib.sha256(lines.encode()).hexdigest()
    short = {name: value[:SHORT_CHARACTERS] for name, value in sorted(hashes.items())}
    return {DIGEST: digest, **short} if hashes else {}


def _hashes(package: Path) -> Iterator[tuple[str, str]]:
    for path in package.rglob("*.py"):
        name = path.relative_to(package).as_posix()
        if name.startswith(CONTROL_PATH) and not name.startswith(ASIDE):
            with suppress(OSError):
                yield name, hashlib.sha256(path.read_bytes()).hexdigest()
