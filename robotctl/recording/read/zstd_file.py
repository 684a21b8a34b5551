"""Recordings that rosbag2 compressed as whole files (`compression_mode: file`)."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from contextlib import closing
from io import FileIO
from pathlib import Path
from typing import Final

from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.read_limits import ReadLimits

SUFFIX: Final = ".zstd"
"""Suffix of a file that rosbag2 compressed."""

_PIECE_BYTES = 1 << 20
_HEAD_BYTES = 18
"""Maximum length of the head of a zstd frame (RFC 8878, 3.1.1.1)."""


def is_zstd_file(path: Path) -> bool:
    """Return whether the name is that of a compressed file."""
    return path.name.endswith(f".mcap{SUFFIX}")


def unpack_zstd_file(fd: int, on_progress: Callable[[int, int], None]) -> int:
    """Decompress the file that is open as `fd` into an unnamed file, and return its descriptor.

    If the data is corrupt, that file holds what precedes the damage. `on_progress` gets bytes done
    and in total.

    Raises:
        Damaged: Nothing can be decompressed, or it exceeds the limits.
        OSError: There is no room for it.
    """
    total = os.fstat(fd).st_size
    limit = ReadLimits.of(total).zstd_file_bytes
    _check_claim(os.pread(fd, _HEAD_BYTES, 0), limit)
    with closing(_temporary_file()) as target, os.fdopen(os.dup(fd), "rb") as source:
        source.seek(0)
        size = 0
        try:
            with ZstdDecompressor().stream_reader(source, read_across_frames=True) as reader:
                while piece := reader.read(_PIECE_BYTES):
                    size += len(piece)
                    if size > limit:
                        raise _beyond(limit)
                    _write(target.fileno(), piece)
                    on_progress(source.tell(), total)
        except ZstdError as error:
            if not size:
                raise Damaged("its zstd data is corrupt") from error
        return os.dup(target.fileno())


def _check_claim(head: bytes, limit: int) -> None:
    try:
        claimed = frame_content_size(head)
    except ZstdError as error:
        raise Damaged("it is not a zstd file") from error
    if claimed > limit:
        raise _beyond(limit)


def _beyond(limit: int) -> BeyondLimit:
    return BeyondLimit(f"unpacked it would take more than {limit >> 20} MiB")


def _temporary_file() -> FileIO:
    try:
        return tempfile.TemporaryFile(buffering=0)
    except OSError as error:
        raise _no_room(error) from error


def _write(fd: int, piece: bytes) -> None:
    try:
        while piece:
            piece = piece[os.write(fd, piece) :]
    except OSError as error:
        raise _no_room(error) from error


def _no_room(error: OSError) -> OSError:
    folder = tempfile.gettempdir()
    reason = f"it cannot be unpacked into {folder}: {error.strerror} (another folder: TMPDIR)"
    return OSError(error.errno, reason)
