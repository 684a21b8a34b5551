"""Who may read a recording: its owner alone, or the group as well; never others.

The umask has no say. What is made of a recording (its list, clips, repaired and recovered files)
is shared with the group if the recording is.
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

_OWNER_READS = {False: 0o600, True: 0o700}
_GROUP_READS = {False: 0o640, True: 0o750}
"""Of a file, of a folder."""


def open_private(path: Path, flags: int) -> int:
    """Open a file, creating it for its owner alone if `flags` say so. Raises OSError."""
    descriptor = os.open(path, flags | os.O_CLOEXEC, _OWNER_READS[False])
    if flags & os.O_CREAT:
        with suppress(OSError):  # a file system without permissions
            os.fchmod(descriptor, _OWNER_READS[False])
    return descriptor


def make_folder(path: Path, *, shared: bool) -> None:
    """Create a folder that must not exist, and the missing ones above it. Raises OSError."""
    missing = [folder for folder in path.parents if not folder.exists()]
    for folder in (*reversed(missing), path):
        folder.mkdir(_OWNER_READS[True], exist_ok=folder != path)
        _set(folder, (_GROUP_READS if shared else _OWNER_READS)[True])


def share_with_group(path: Path) -> None:
    """Let the group read a file or a folder of ours. Raises OSError if there is none."""
    _set(path, _GROUP_READS[path.is_dir()])


def share_like(path: Path, source: Path) -> None:
    """Let the group read what was made of `source` if it may read that. Raises OSError."""
    if is_shared(source):
        share_with_group(path)


def is_shared(path: Path) -> bool:
    """Whether the group may read what others may not. Raises OSError."""
    return path.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH) == stat.S_IRGRP


def _set(path: Path, mode: int) -> None:
    before = path.stat().st_mode
    if stat.S_ISDIR(before):
        mode |= before & stat.S_ISGID  # what is made in the folder gets its group
    if stat.S_IMODE(before) != mode:
        with suppress(OSError):  # a file system without permissions
            path.chmod(mode)
