"""Files of recordings on the disk: access rights, atomic output, writes at an offset.

Only the owner and, if shared, the group may read a recording and files made from it.
"""

from __future__ import annotations

import errno
import os
import stat
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from fcntl import LOCK_EX, LOCK_NB, LOCK_SH, LOCK_UN, flock
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import IO, Final, Protocol

from robotctl.base.errors import Refused

_OWNER_READS = {False: 0o600, True: 0o700}
_GROUP_READS = {False: 0o640, True: 0o750}
"""Access modes, by whether the path is a folder."""


def open_private(path: Path, flags: int) -> int:
    """Open a file. With O_CREAT in `flags`, only its owner may access it.

    Raises:
        OSError: The file cannot be opened.
    """
    descriptor = os.open(path, flags | os.O_CLOEXEC, _OWNER_READS[False])
    if flags & os.O_CREAT:
        with suppress(OSError):  # a file system without permissions
            os.fchmod(descriptor, _OWNER_READS[False])
    return descriptor


def make_folder(path: Path, *, shared: bool) -> None:
    """Create a new folder and its missing parents, readable by the group if `shared`.

    Raises:
        OSError: The folder exists, or cannot be created.
    """
    missing = [folder for folder in path.parents if not folder.exists()]
    for folder in (*reversed(missing), path):
        folder.mkdir(_OWNER_READS[True], exist_ok=folder != path)
        _set(folder, (_GROUP_READS if shared else _OWNER_READS)[True])


def protect_like(path: Path, source: Path) -> None:
    """Limit access to `path` to its owner and, if the group may read `source`, to the group.

    Raises:
        OSError: `path` or `source` does not exist.
    """
    _set(path, (_GROUP_READS if is_shared(source) else _OWNER_READS)[path.is_dir()])


def share_with_group(path: Path) -> None:
    """Make a file or folder of this user readable for its group.

    Raises:
        OSError: There is no such file.
    """
    _set(path, _GROUP_READS[path.is_dir()])


def share_like(path: Path, source: Path) -> None:
    """Make `path` readable for its group if the group may read `source`, its origin.

    Raises:
        OSError: `path` or `source` does not exist.
    """
    if is_shared(source):
        share_with_group(path)


def is_shared(path: Path) -> bool:
    """Return whether the group may read `path` and other users may not.

    Raises:
        OSError: There is no such file.
    """
    return path.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH) == stat.S_IRGRP


def _set(path: Path, mode: int) -> None:
    before = path.stat().st_mode
    if stat.S_ISDIR(before):
        mode |= before & stat.S_ISGID  # new files in the folder inherit its group
    if stat.S_IMODE(before) != mode:
        with suppress(OSError):  # a file system without permissions
            path.chmod(mode)


_CURES: Final[Mapping[int, str]] = {
    errno.ENOSPC: "free disk space",
    errno.EDQUOT: "free disk space, or ask for a higher quota",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f)",
    errno.EIO: "check the disk and its cable (sudo dmesg)",
    errno.EROFS: "mount the disk writable, and check why it is not (sudo dmesg)",
    errno.EACCES: "give this user the right to write there",
    errno.EPERM: "give this user the right to write there",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "raise the limit of open files of this machine (sysctl fs.file-max)",
    errno.ENOENT: "check that the disk is mounted and the folder is not removed",
    errno.ESTALE: "check that the disk is mounted",
    errno.ENODEV: "check that the disk is mounted",
    errno.ENXIO: "check that the disk is mounted",
    errno.ENOMEM: "free memory",
}


def size_of(path: Path) -> int:
    """Return the size of a file [bytes], 0 if it cannot be read."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def reason_of(error: BaseException) -> str:
    """Return the cause of the error as a phrase for an error text."""
    return (error.strerror if isinstance(error, OSError) else None) or repr(error)


def cure_of(error: BaseException) -> str:
    """Return advice about the error as a phrase for an error text."""
    if isinstance(error, MemoryError):
        return _CURES[errno.ENOMEM]
    if isinstance(error, OSError) and error.errno is not None:
        return _CURES.get(error.errno, "check the disk and the folder")
    return "see robotctl logs"


@contextmanager
def replaced_file(target: Path) -> Iterator[IO[bytes]]:
    """Yield a file that replaces `target` at the end of the block, unless the block raises.

    The group may read the file if it may read the folder of `target`.

    Raises:
        OSError: The file cannot be written, or `target` is not a regular file.
    """
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(target.lstat().st_mode):
            raise FileExistsError(errno.EEXIST, "what is there is no regular file", str(target))
    unfinished = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    with suppress(FileNotFoundError):
        unfinished.unlink()
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    try:
        with open(open_private(unfinished, flags), "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        share_like(unfinished, target.parent)
        unfinished.replace(target)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink()
        raise


@contextmanager
def atomic_output(target: Path, source: Path) -> Iterator[Path]:
    """Yield a path for the block's new file or folder, which then becomes `target`.

    If the block raises, nothing remains. A kill leaves a hidden folder next to `target`. The group
    may read `target` if it may read `source`.

    Raises:
        Refused: `target` exists already, or cannot be written.
    """
    folder: Path | None = None
    try:
        _check_free(target)
        folder = Path(mkdtemp(prefix=f".{target.name[:100]}.", dir=target.parent))
        unfinished = folder / target.name
        yield unfinished
        for path in (*(unfinished.rglob("*") if unfinished.is_dir() else ()), unfinished):
            protect_like(path, source)
            _sync(path)
        _check_free(target)
        unfinished.rename(target)
        _sync(target.parent)
    except OSError as error:
        cure = "choose another name" if error.errno == errno.EEXIST else cure_of(error)
        raise Refused(f"cannot write {target}: {reason_of(error)}", cure) from error
    finally:
        if folder is not None:
            rmtree(folder, ignore_errors=True)


def _check_free(target: Path) -> None:
    if os.path.lexists(target):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))


Buffer = bytes | bytearray | memoryview

MAX_PARTS = 1024
"""`pwritev` accepts at most IOV_MAX parts at once (limits.h of Linux)."""

_LOCK_TRIES = 50
_LOCK_WAIT_S = 0.002


class Storage(Protocol):
    """The file operations of a writer. Every method may raise OSError."""

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write all of `parts`, concatenated, at `offset` [bytes]."""

    def truncate(self, size: int) -> None:
        """Cut the file to `size` bytes."""

    def sync(self) -> None:
        """Force all data written so far to the disk."""

    def close(self) -> None:
        """Close the file."""


def is_being_written(path: Path) -> bool:
    """Return whether a running process has `path` open as a DiskFile.

    Raises:
        OSError: The file cannot be opened.
    """
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        return is_locked(fd)
    finally:
        os.close(fd)


def is_locked(fd: int) -> bool:
    """Return whether a DiskFile has locked the file of the descriptor `fd`.

    Raises:
        OSError: The file system has no locks.
    """
    try:
        flock(fd, LOCK_SH | LOCK_NB)
    except BlockingIOError:
        return True
    flock(fd, LOCK_UN)
    return False


def _lock(fd: int) -> None:
    """Lock for writing if possible. Retry for 0.1 s: `is_locked` holds the lock for a moment."""
    for _ in range(_LOCK_TRIES):
        try:
            flock(fd, LOCK_EX | LOCK_NB)
        except BlockingIOError:
            time.sleep(_LOCK_WAIT_S)
        except OSError:
            return  # some network file systems have no locks
        else:
            return


def _sync(path: Path) -> None:
    """Write a file, or the entries of a folder, to the disk (fsync)."""
    fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot sync folders
            raise
    finally:
        os.close(fd)


class DiskFile:
    """A `Storage` on disk, locked while it is open. A new file is private to its owner."""

    def __init__(self, path: Path, *, new: bool = True) -> None:
        """Create `path` or, if not `new`, open it.

        Raises:
            OSError: The file cannot be created or opened, or is there already.
        """
        flags = os.O_WRONLY | os.O_NOFOLLOW
        if new:
            flags |= os.O_CREAT | os.O_EXCL
        self._fd = open_private(path, flags)
        try:
            _lock(self._fd)
            _sync(path.parent)  # the name must survive a power cut, too
        except BaseException:
            os.close(self._fd)
            if new:
                with suppress(OSError):
                    path.unlink()
            raise

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        """Write all of `parts` at `offset`.

        Raises:
            OSError: The disk is full or fails.
        """
        rest = [memoryview(part) for part in parts if len(part)]
        while rest:
            written = os.pwritev(self._fd, rest[:MAX_PARTS], offset)
            if written == 0:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            offset += written
            while rest and written >= rest[0].nbytes:
                written -= rest.pop(0).nbytes
            if written:
                rest[0] = rest[0][written:]

    def truncate(self, size: int) -> None:
        """Cut the file to `size` bytes."""
        os.ftruncate(self._fd, size)

    def sync(self) -> None:
        """Force the data to the disk.

        Raises:
            OSError: The disk fails, or the file was removed.
        """
        os.fdatasync(self._fd)
        if os.fstat(self._fd).st_nlink == 0:
            raise OSError(errno.ENOENT, "the file was removed")

    def close(self) -> None:
        """Close the descriptor. Closing twice is harmless."""
        descriptor, self._fd = self._fd, -1
        if descriptor >= 0:
            os.close(descriptor)


@contextmanager
def new_file(target: Path, open_file: Callable[[Path], Storage] = DiskFile) -> Iterator[Storage]:
    """Yield the new file `target`, which is closed after the block or removed if it raises.

    Raises:
        Refused: `target` exists already, or cannot be written.
    """
    try:
        storage = open_file(target)
    except (OSError, ValueError) as error:
        raise Refused(f"cannot write {target}: {_reason(error)}") from error
    try:
        yield storage
    except BaseException as error:
        with suppress(OSError):
            target.unlink()
        if isinstance(error, OSError):
            raise Refused(f"cannot write {target}: {_reason(error)}") from error
        raise
    finally:
        with suppress(OSError):  # the file is synced, or removed
            storage.close()


def _reason(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
