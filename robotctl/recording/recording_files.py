"""Which files a recording consists of."""

from __future__ import annotations

import re
from pathlib import Path
from stat import S_ISDIR, S_ISREG

from robotctl.errors import UnreadableFile
from robotctl.recording import rosbag2


def recording_files(path: Path) -> list[Path]:
    """The MCAP files of a recording in their order. Raises UnreadableFile if there are none."""
    try:
        mode = path.stat().st_mode
        found = sorted(path.glob("*.mcap"), key=natural_order) if S_ISDIR(mode) else [path]
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else None
        raise UnreadableFile(f"{path} cannot be read: {reason or error}") from error
    if not (S_ISDIR(mode) or S_ISREG(mode)):
        raise UnreadableFile(f"{path} is no file", "give an MCAP file or a recording's folder")
    if not found:
        raise UnreadableFile(f"{path} holds no .mcap file")
    return found


def absent_files(folder: Path, present: list[Path]) -> list[str]:
    """A sentence for each file that the folder's `metadata.yaml` names beside those present."""
    names = {path.name for path in present}
    return [
        f"{name}: metadata.yaml names it, but it is not there"
        for name in rosbag2.named_files(folder)
        if name not in names
    ]


def natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Sorts `run_10` behind `run_9`."""
    parts = re.split(r"(\d+)", path.name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]
