"""The options of the recorder."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from robotctl.recording.disk.storage import DiskFile, Storage
from robotctl.recording.format.compression import Compression
from robotctl.recording.write.file_seal import Sealer


def free_space(folder: Path) -> int:
    """Return the bytes that this user may still write below `folder`.

    Raises:
        OSError: The folder cannot be examined.
    """
    disk = os.statvfs(folder)
    return disk.f_bavail * disk.f_frsize


@dataclass(frozen=True, slots=True)
class RecorderOptions:
    """Sizes and times of the recorder.

    A footer follows the data after `chunk_bytes` or `flush_s`, whichever comes first; data survives
    a power cut after `sync_s`. `memory_bytes` is the budget for everything in memory: messages that
    wait for the disk and, up to a third of it, the latched messages that the next file repeats.
    Messages that do not fit are counted. A new file begins at `split_bytes` or after `split_s`. The
    recorder warns when the disk has less than `warn_free_bytes` left, and stops at
    `stop_free_bytes`. With `group_readable` the group may read the recording, otherwise only its
    owner may. `records` are further metadata records for the beginning of each file, by their name.
    `sealer` seals the files, if it is given.
    The messages of the topics in `evidence` stand in chunks of their own where others are heavy.
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
    records: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    sealer: Sealer | None = None
    evidence: frozenset[str] = frozenset()
    open_file: Callable[[Path], Storage] = DiskFile
    free_space: Callable[[Path], int] = free_space
