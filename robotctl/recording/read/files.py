"""The files of a recording, and the sources of their bytes."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shlex import quote
from stat import S_ISDIR, S_ISREG
from typing import Final, Protocol

from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.base.errors import UnreadableFile
from robotctl.base.files import open_regular
from robotctl.base.store import RemoteFile
from robotctl.recording.format.disk import is_locked, size_of
from robotctl.recording.format.names import natural_order
from robotctl.recording.format.records import MAGIC
from robotctl.recording.format.rosbag2 import METADATA_FILE, entries_of, files_in, read_metadata
from robotctl.recording.read.read_limits import Damaged, ReadLimits, beyond_unpacking

SUFFIX: Final = ".zstd"
"""Suffix of a file compressed by rosbag2."""

_PIECE_BYTES = 1 << 20
_HEAD_BYTES = 18
"""Maximum length of the head of a zstd frame (RFC 8878, 3.1.1.1)."""


def is_zstd_file(path: Path) -> bool:
    """Return whether the name is that of a compressed file."""
    return path.name.endswith(f".mcap{SUFFIX}")


def unpack_zstd_file(fd: int, on_progress: Callable[[int, int], None]) -> int:
    """Decompress the file `fd` into an unnamed file, and return the new descriptor.

    The result ends at corrupt data. `on_progress` gets bytes done and in total.

    Raises:
        Damaged: Nothing can be decompressed, or the result exceeds the limits.
        OSError: There is no room for the unnamed file.
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
    """Name the temporary folder in an OSError of the block."""
    try:
        yield
    except OSError as error:
        folder = tempfile.gettempdir()
        reason = f"it cannot be unpacked into {folder}: {error.strerror} (another folder: TMPDIR)"
        raise OSError(error.errno, reason) from error


class Source(Protocol):
    """A file, perhaps growing, that is read by ranges.

    All methods but `close` may raise OSError or, if a remote store fails, UnreadableFile.
    """

    def size(self) -> int:
        """Return the present size [bytes]."""

    def stored_bytes(self) -> int:
        """Return the stored size [bytes], less than `size` for a file compressed as a whole."""

    def read(self, offset: int, length: int) -> bytes:
        """Return at most `length` bytes at `offset`, b"" only at the end of the file."""

    def is_written(self) -> bool:
        """Return whether a process has the file open for recording."""

    def close(self) -> None:
        """Close the file. Closing twice is harmless."""


def open_source(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Source:
    """Open a file. `on_progress` gets bytes done and in total of a decompression.

    Raises:
        OSError: The file cannot be opened, or is not a regular file.
        Damaged: The file cannot be decompressed.
        UnreadableFile: The store fails.
    """
    return RemoteSource(path) if isinstance(path, RemoteFile) else LocalSource(path, on_progress)


class LocalSource:
    """A regular file of this machine. A `.mcap.zstd` is decompressed first."""

    def __init__(
        self, path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
    ) -> None:
        """Open `path`. `on_progress` gets bytes done and in total of a decompression.

        Raises:
            OSError: The file cannot be opened, or is not a regular file.
            Damaged: The file cannot be decompressed.
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
        """Return the present size [bytes] or, for a compressed file, that of its content."""
        return os.fstat(self._fd).st_size

    def stored_bytes(self) -> int:
        """Return the size of the file on the disk [bytes]."""
        return self.size() if self._packed_bytes is None else self._packed_bytes

    def read(self, offset: int, length: int) -> bytes:
        """Return at most `length` bytes at `offset`, b"" only at the end of the file."""
        return os.pread(self._fd, length, offset)

    def is_written(self) -> bool:
        """Return whether a process has the file open for recording."""
        return is_locked(self._fd)

    def close(self) -> None:
        """Close the file. Closing twice is harmless."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class RemoteSource:
    """A file at a URL. The stored object never changes in place."""

    def __init__(self, path: RemoteFile) -> None:
        """Look up the file.

        Raises:
            UnreadableFile: The store fails.
        """
        self._size = path.stat().st_size
        self._reader = path.reader()

    def size(self) -> int:
        """Return the size that the object had when it was opened [bytes]."""
        return self._size

    def stored_bytes(self) -> int:
        """Return `size`, as the file is never decompressed."""
        return self._size

    def read(self, offset: int, length: int) -> bytes:
        """Return at most `length` bytes at `offset`, b"" only at the end of the file."""
        return self._reader.read(offset, length)

    def is_written(self) -> bool:
        """Return False, as an object is complete when it appears."""
        return False

    def close(self) -> None:
        """Do nothing, as no connection is open."""


Progress = Callable[[int, int], None]
"""Called with the bytes done, and the bytes in total."""

SQLITE_SUFFIX = ".db3"
"""Suffix of the files of rosbag2's sqlite3 storage."""

DENIED_CURE = "run this as its owner, or record with recording.group_readable: true"

_FILES_OF_RECORDINGS = (
    *("*.mcap", f"*.mcap{SUFFIX}", f"*{SQLITE_SUFFIX}*", METADATA_FILE),
    "*/*.mcap",
    f"*/{'[0-9a-f]' * 64}/*.mcap",
)
"""Patterns for the content of a folder that is a recording, or holds recordings."""


def recording_files(path: Path) -> list[Path]:
    """Return the MCAP files of a recording, in their order.

    Raises:
        UnreadableFile: There are none, or `path` is not a recording.
    """
    try:
        mode = path.stat().st_mode
        found = files_of_bag(path) if S_ISDIR(mode) else [path]
    except (OSError, ValueError) as error:
        raise UnreadableFile(f"{path} cannot be read: {reason_of(error)}") from error
    if not (S_ISDIR(mode) or S_ISREG(mode)):
        raise UnreadableFile(f"{path} is not a file", "give an MCAP file or a recording's folder")
    if path.suffix == SQLITE_SUFFIX or (not found and any(path.glob(f"*{SQLITE_SUFFIX}*"))):
        raise UnreadableFile(
            f"{path} is a bag in sqlite3 format",
            f"robotctl convert {quote(str(path))} {quote(path.stem + '_mcap')}",
        )
    if not found:
        raise UnreadableFile(f"{path} holds no .mcap file")
    return found


def reason_of(error: OSError | ValueError) -> str:
    """Return the reason of a read error, with advice if this user lacks the permission."""
    reason = getattr(error, "strerror", None) or str(error) or repr(error)
    return f"{reason} ({DENIED_CURE})" if isinstance(error, PermissionError) else reason


def metadata_of_folder(folder: Path) -> tuple[str, list[str]]:
    """Return the text of `metadata.yaml` ("" if none), and a list with the read error, if any."""
    try:
        return read_metadata(folder), []
    except (OSError, ValueError) as error:
        return "", [f"{METADATA_FILE} cannot be read: {reason_of(error)}"]


def may_not_be_listed(path: Path) -> bool:
    """Return whether `path` is a folder, other than `lost+found`, that this user may not list."""
    try:
        next(path.iterdir(), None)
    except PermissionError:
        return path.name != "lost+found"
    except OSError:
        pass
    return False


def is_bag(path: Path) -> bool:
    """Return whether `path` is a folder with MCAP files, or one that this user may not list."""
    if not path.is_dir():
        return False
    try:
        return any(each.suffix == ".mcap" for each in entries_of(path))
    except OSError:
        return may_not_be_listed(path)


def is_recording(path: Path) -> bool:
    """Return whether `path` looks like a recording or a folder of recordings.

    True also for a damaged recording and for a path that cannot be examined.
    """
    try:
        mode = path.stat().st_mode
        if S_ISDIR(mode):
            found = any(next(path.glob(pattern), None) for pattern in _FILES_OF_RECORDINGS)
            return found or may_not_be_listed(path)
        if path.suffix in (".mcap", SQLITE_SUFFIX) or path.name.endswith(f".mcap{SUFFIX}"):
            return True
        if not S_ISREG(mode):
            return False
        with open_regular(path) as file:
            return file.read(len(MAGIC)) == MAGIC
    except (OSError, ValueError):
        return True


def files_of_bag(folder: Path) -> list[Path]:
    """Return the MCAP files in a folder, compressed or not.

    Raises:
        OSError: The folder cannot be listed.
    """
    entries = entries_of(folder)  # unlike glob, it raises where the user may not list
    files = [path for path in entries if path.name.endswith(".mcap")]
    names = {path.name for path in files}
    packed = [
        path for path in entries if path.name.endswith(f".mcap{SUFFIX}") and path.stem not in names
    ]
    return sorted([*files, *packed], key=natural_order)


def each_with_progress(
    paths: Sequence[Path], on_progress: Progress
) -> Iterator[tuple[Path, Progress]]:
    """Yield each path, and a function to call with its progress (done, total) in any unit.

    That function calls `on_progress` with the bytes done and in total, over all paths.
    """
    sizes = [size_of(path) for path in paths]
    total = sum(sizes)
    for number, path in enumerate(paths):
        before, size = sum(sizes[:number]), sizes[number]

        def tell(done: int, of: int, before: int = before, size: int = size) -> None:
            on_progress(before + min(done, of) * size // max(of, 1), total)

        yield path, tell


def absent_files(text: str, present: list[Path]) -> list[str]:
    """Return a sentence for each file in `text`, a `metadata.yaml`, that is not in `present`."""
    return [
        f"{name}: metadata.yaml names it, but it is not there"
        for name in absent_names(text, present)
    ]


def absent_names(text: str, present: list[Path]) -> list[str]:
    """Return the files in `text`, a `metadata.yaml`, that are not in `present`, compressed or not.

    Read `text` before listing the folder: a daemon creates a file before `metadata.yaml` names it.
    """
    names = {path.name.removesuffix(SUFFIX) for path in present}
    return [name for name in files_in(text) if name.removesuffix(SUFFIX) not in names]
