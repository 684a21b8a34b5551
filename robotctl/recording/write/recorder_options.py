"""How the recorder writes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from robotctl.recording.disk.storage import DiskFile, Storage
from robotctl.recording.format.compression import Compression


def free_space(folder: Path) -> int:
    """Bytes that this user may still write below `folder`. Raises OSError."""
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize


@dataclass(frozen=True, slots=True)
class RecorderOptions:
    """Sizes and times of the recorder.

    A footer follows the data after `chunk_bytes` or `flush_s`, whichever comes first; after
    `sync_s` data survives a power cut. `memory_bytes` is the budget for all that waits in memory:
    for the disk and, up to a third of it, latched messages for the next file, which repeats them.
    What does not fit is counted. A file is followed by another at `split_bytes` or after `split_s`.
    The recorder warns when the disk has less than `warn_free_bytes` left, and stops at
    `stop_free_bytes`. If `group_readable`, the group may read what is recorded, otherwise only the
    owner may.
    """

    compression: Compression = Compression.ZSTD
    compression_level: int = 1
    chunk_bytes: int = 1 << 20
    flush_s: float = 0.25
    sync_s: float = 1.0
    memory_bytes: int = 96 << 20
    split_bytes: int = 256_000_000
    split_s: float = 600.0
    warn_free_bytes: int = 2_000_000_000
    stop_free_bytes: int = 500_000_000
    group_readable: bool = False
    open_file: Callable[[Path], Storage] = DiskFile
    free_space: Callable[[Path], int] = free_space
