"""The versions of the software that makes a recording: metadata of each file."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import robotctl
from robotctl.environment import DISTRO, RMW

MAX_GIT_BYTES = 4 << 20
"""Limit of `packed-refs`; a larger file is not read."""

_REVISION = re.compile(r"[0-9a-f]{40}(?:[0-9a-f]{24})?")


def provenance() -> dict[str, str]:
    """Return versions, host and git revisions, as far as they are known.

    `git.robotctl` is the commit of robotctl's own source tree, `git.directory` that of the
    repository in which the daemon was started; each is left out if there is none.
    """
    try:
        directory = Path.cwd()
    except OSError:  # it was removed
        directory = None
    known = {
        "robotctl": robotctl.__version__,
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()).strip(),
        "ros_distro": DISTRO,
        "rmw": RMW,
        "rclpy": _version("rclpy"),
        "mcap": _version("mcap"),
        "host": os.uname().nodename,
        "directory": "" if directory is None else str(directory),
        "git.robotctl": revision(Path(robotctl.__file__).parents[1]),
        "git.directory": "" if directory is None else revision_around(directory),
    }
    return {name: value for name, value in known.items() if value}


def revision_around(folder: Path) -> str:
    """Return the commit of the repository that contains `folder`, "" if there is none."""
    return next(filter(None, map(revision, (folder, *folder.parents))), "")


def revision(folder: Path) -> str:
    """Return the commit that is checked out in `folder`, "" if it is not a repository's root.

    Reads git's files (gitrepository-layout(5)): the git command may take seconds or hang.
    """
    try:
        git = folder / ".git"
        if git.is_file():  # of a worktree or submodule
            git = folder / git.read_text().strip().removeprefix("gitdir: ")
        head = (git / "HEAD").read_text().strip()
        name = head.removeprefix("ref: ")
        candidates = [head] if name == head else _values(git, name)
        return next(filter(_REVISION.fullmatch, candidates), "")
    except (OSError, ValueError):
        return ""


def _values(git: Path, name: str) -> Iterator[str]:
    """Yield the possible values of the reference `name`."""
    common = git / "commondir"
    for place in (git, git / common.read_text().strip()) if common.exists() else (git,):
        if (place / name).is_file():
            yield (place / name).read_text().strip()
        packed = place / "packed-refs"
        if packed.is_file() and packed.stat().st_size <= MAX_GIT_BYTES:
            for line in packed.read_text().splitlines():
                commit, _, reference = line.partition(" ")
                if reference == name:
                    yield commit


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""
