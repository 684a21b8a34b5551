"""Which code decides and commands: a content hash of each of its modules."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

import robotctl

CONTROL_PATH: Final = ("cdr", "config", "daemon", "ipc", "kernel", "ros", "sim")
"""The packages of everything between a message or request and the command that follows from it."""

ASIDE: Final = ("ros/executables", "ros/playback")
"""Folders in them that no daemon imports."""

DIGEST: Final = "digest"
"""The key of the hash over all modules, among their names."""

SHORT_CHARACTERS: Final = 16
"""Of a module's hash: it names the module that differs; the digest is over the whole hashes."""


@cache
def software(package: Path = Path(robotctl.__file__).parent) -> dict[str, str]:
    """Return the beginning of each module's SHA-256 by its name, and the digest over all.

    The digest is the SHA-256 of a line `HASH  NAME` for each module, with the whole hash, ordered
    by name, as sha256sum(1) prints them. Read once, at the first call, so call it early: the files
    of a daemon that runs may be replaced. Modules whose source cannot be read are left out.
    """
    hashes = dict(_hashes(package))
    lines = "".join(f"{value}  {name}\n" for name, value in sorted(hashes.items()))
    digest = hashlib.sha256(lines.encode()).hexdigest()
    short = {name: value[:SHORT_CHARACTERS] for name, value in sorted(hashes.items())}
    return {DIGEST: digest, **short} if hashes else {}


def _hashes(package: Path) -> Iterator[tuple[str, str]]:
    """Yield the name and the SHA-256 of each module of the control path."""
    aside = tuple(package / folder for folder in ASIDE)
    for part in CONTROL_PATH:
        for path in (package / part).rglob("*.py"):
            if not any(path.is_relative_to(folder) for folder in aside):
                try:
                    content = path.read_bytes()
                except OSError:
                    continue
                yield path.relative_to(package).as_posix(), hashlib.sha256(content).hexdigest()
