"""The order in which the files of a recording follow each other."""

from __future__ import annotations

import re
from pathlib import Path


def natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Return a sort key that puts `run_10` after `run_9`."""
    parts = re.split(r"(\d+)", path.name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]
