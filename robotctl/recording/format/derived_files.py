"""The files that robotctl makes from a recording, in its folder; they are removed with it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

PICTURE_FILE: Final = "path.png"
"""The path of the last drive that a command waited for."""

PAGE_FILE: Final = "report.html"

INDEX_FILE: Final = "index.parquet"
"""What `robotctl index` makes."""

_COMPARISONS: Final = "compared_with_*.html"
"""Pages that earlier versions made of two recordings."""


def derived_files(folder: Path) -> Iterator[Path]:
    """Yield the files in a recording's folder that robotctl made from it.

    Raises:
        OSError: The folder cannot be read.
    """
    unfinished_index = f".{INDEX_FILE}.*.tmp"  # of a process that was killed
    made = (PICTURE_FILE, PAGE_FILE, INDEX_FILE, unfinished_index, _COMPARISONS)
    for pattern in made:
        yield from folder.glob(pattern)
