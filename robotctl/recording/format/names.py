"""Names of records, events, compressions and files in recordings. Fast to import."""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator
from enum import Enum, StrEnum
from pathlib import Path
from typing import Final

import robotctl

PROFILE = "ros2"
OWN_LIBRARY = "robotctl "
"""Prefix of the library name in the header of robotctl's files."""

LIBRARY = OWN_LIBRARY + robotctl.__version__
INFO_RECORD = "robotctl"
"""Robot, parameters and software, written when a file begins."""

OBSERVING = "observing"
"""The `mode` in INFO_RECORD of a daemon that does not drive the robot."""

PARAMETER_PREFIX = "parameter."
"""Prefix of the keys of configuration parameters in INFO_RECORD."""

SOFTWARE_RECORD = "robotctl.software"
"""The content hashes of the modules that decide and command, written when a file begins."""

SHADOW_RECORD = "robotctl.shadow"
"""In files of versions 0.1 and 0.2: the parameters of a second kernel that did not drive."""

FOXGLOVE_RECORD = "foxglove"
"""The name of the device for Foxglove, written when a file begins."""

EVENT_RECORD = "robotctl.event"
"""One event of the recording, as in `recorded_events`."""

LEDGER_RECORD = "robotctl.ledger"
"""Message counts by topic since the recording began, in JSON, written when a file is finished."""

CLIP_RECORD = "robotctl.clip"
"""In a clip: the source files, the event and the losses."""

RECOVERY_RECORD = "robotctl.recovery"
"""In a recovered or repaired file: the losses."""

CONVERSION_RECORD = "robotctl.conversion"
"""In a converted file: the source files and the losses."""

OWN_ARITHMETIC = "own arithmetic, "
"""Prefix of `MADE_BY` if the kernel computed with its own sin, cos, atan2 and hypot."""

_PLATFORM = f"Python {platform.python_version()}, {' '.join(platform.libc_ver())}".rstrip()

MADE_BY = f"{OWN_ARITHMETIC}{_PLATFORM}"
"""The origin of the floats of a recording. Without OWN_ARITHMETIC, it is the C library."""


class EventKind(StrEnum):
    """The kind of an event."""

    EMERGENCY_STOP = "estop"
    ERROR = "error"
    MARK = "mark"
    DRIVE_ENDED = "drive ended"


CLIP_KINDS = tuple(kind for kind in EventKind if kind is not EventKind.DRIVE_ENDED)
"""The kinds of events for clips."""


class Compression(Enum):
    """The compression of chunks, with the values of `recording.compression`."""

    ZSTD = "zstd"
    LZ4 = "lz4"
    NONE = "none"

    @property
    def mcap_name(self) -> str:
        """The name in a chunk record (https://mcap.dev/spec/registry), "" without compression."""
        return "" if self is Compression.NONE else self.value


def natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Return a sort key by the name of `path` that puts `run_10` after `run_9`."""
    parts = re.split(r"(\d+)", path.name)
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts]


PICTURE_FILE: Final = "path.png"
"""A picture of the path of the last drive of a waiting command."""

PAGE_FILE: Final = "report.html"

INDEX_FILE: Final = "index.parquet"
"""The file of `robotctl index`."""

_COMPARISONS: Final = "compared_with_*.html"
"""Pages in which earlier versions compared two recordings."""


def derived_files(folder: Path) -> Iterator[Path]:
    """Yield the files in a recording's folder that robotctl made from the recording.

    Raises:
        OSError: The folder cannot be read.
    """
    unfinished_index = f".{INDEX_FILE}.*.tmp"  # of a process that was killed
    made = (PICTURE_FILE, PAGE_FILE, INDEX_FILE, unfinished_index, _COMPARISONS)
    for pattern in made:
        yield from folder.glob(pattern)
