"""Where the bytes of a file come from: the disk, a store, or anything that returns ranges."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Final, Protocol

from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.base.store.remote_file import RemoteFile
from robotctl.recording.disk.storage import is_locked
from robotctl.recording.read.read_limits import Damaged, ReadLimits, beyond_unpacking

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
    try:
        claimed = frame_content_size(os.pread(fd, _HEAD_BYTES, 0))
    except ZstdError as error:
        raise Damaged("it is not a zstd file") from error
    if claimed > limit:
        raise beyond_unpacking(limit)
    with ExitStack() as stack:
        with _room():
            target = stack.enter_context(tempfile.TemporaryFile(buffering=0))
        source = stack.enter_context(os.fdopen(os.dup(fd), "rb"))
        source.seek(0)
        size = 0
        try:
            with ZstdDecompressor().stream_reader(source, read_across_frames=True) as reader:
                while piece := reader.read(_PIECE_BYTES):
                    size += len(piece)
                    if size > limit:
                        raise beyond_unpacking(limit)
                    with _room():
                        while piece:
                            piece = piece[target.write(piece) :]
                    on_progress(source.tell(), total)
        except ZstdError as error:
            if not size:
                raise Damaged("its zstd data is corrupt") from error
        return os.dup(target.fileno())


@contextmanager
def _room() -> Iterator[None]:
    """Say of an OSError in the block that there is no room for the decompressed file."""
    try:
        yield
    except OSError as error:
        folder = tempfile.gettempdir()
        reason = f"it cannot be unpacked into {folder}: {error.strerror} (another folder: TMPDIR)"
        raise OSError(error.errno, reason) from error


class Source(Protocol):
    """A file that is read by ranges; it may grow.

    Every method but `close` may raise OSError, or UnreadableFile, which ends the reading.
    """

    def size(self) -> int:
        """Return the present size [bytes]."""

    def stored_bytes(self) -> int:
        """Return the stored size [bytes]: less than `size` if the file is compressed as a whole."""

    def read(self, offset: int, length: int) -> bytes:
        """Return `length` bytes at `offset`, or fewer; none only at the end."""

    def is_written(self) -> bool:
        """Return whether a process has the file open for recording."""

    def close(self) -> None:
        """Close it; closing twice is harmless."""


def open_source(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Source:
    """Open a file; `on_progress` gets bytes done and in total while it is decompressed.

    Raises:
        OSError: It cannot be opened, or is not a regular file.
        Damaged: It cannot be decompressed.
        UnreadableFile: The store fails.
    """
    return RemoteSource(path) if isinstance(path, RemoteFile) else LocalSource(path, on_progress)


class LocalSource:
    """A regular file of this machine. A `.mcap.zstd` is decompressed first."""

    def __init__(
        self, path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
    ) -> None:
        """Open `path`; `on_progress` gets bytes done and in total while decompressing.

        Raises:
            OSError: It cannot be opened, or is not a regular file.
            Damaged: It cannot be decompressed.
        """
        self._fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        self._packed_bytes: int | None = None
        try:
            status = os.fstat(self._fd)
            if not stat.S_ISREG(status.st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file", str(path))
            if is_zstd_file(path):
                self._packed_bytes = status.st_size
                packed = self._fd
                self._fd = unpack_zstd_file(packed, on_progress)
                os.close(packed)
        except BaseException:
            self.close()
            raise

    def size(self) -> int:
        """Return the present size [bytes], decompressed."""
        return os.fstat(self._fd).st_size

    def stored_bytes(self) -> int:
        """Return the bytes on the disk."""
        return self.size() if self._packed_bytes is None else self._packed_bytes

    def read(self, offset: int, length: int) -> bytes:
        """Return `length` bytes at `offset`, or fewer; none only at the end."""
        return os.pread(self._fd, length, offset)

    def is_written(self) -> bool:
        """Return whether a process has it open for recording."""
        return is_locked(self._fd)

    def close(self) -> None:
        """Close it; closing twice is harmless."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class RemoteSource:
    """A file at a URL, which cannot be changed in place."""

    def __init__(self, path: RemoteFile) -> None:
        """Look up the file.

        Raises:
            UnreadableFile: The store fails.
        """
        self._size = path.stat().st_size
        self._reader = path.reader()

    def size(self) -> int:
        """Return the size at the time of the look-up [bytes]."""
        return self._size

    def stored_bytes(self) -> int:
        """Return `size`: the file is never decompressed."""
        return self._size

    def read(self, offset: int, length: int) -> bytes:
        """Return `length` bytes at `offset`, or fewer; none only at the end."""
        return self._reader.read(offset, length)

    def is_written(self) -> bool:
        """Return False: an object is complete when it appears."""
        return False

    def close(self) -> None:
        """Do nothing: no connection is open for it."""
