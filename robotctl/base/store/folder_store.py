"""A folder as a store, with the methods of `ObjectStore`. Standard library only."""

from __future__ import annotations

import ctypes
import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Final

from robotctl.base.files import remove_abandoned, sync_folder
from robotctl.base.store.objects import (
    NO_STAMP,
    AccessDenied,
    NoSuchObject,
    Stamp,
    StoredObject,
    StoreError,
    StoreFailed,
    changed,
    check_key,
    short_answer,
)
from robotctl.base.text import printable

PREFIX: Final = ".unfinished-"

_AT_FDCWD: Final = -100
_RENAME_NOREPLACE: Final = 1
"""A flag of renameat2(2); os.rename cannot pass it."""


class FolderStore:
    """The files below a folder; see `ObjectStore`. Links below the folder are not followed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def name(self) -> str:
        """Return the path of the folder."""
        return printable(self._folder)

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Yield the files below the folder `prefix`, at any depth."""
        top = self._path(prefix) if prefix else self._folder

        def failed(error: OSError) -> None:
            raise error

        with self._told(prefix):
            for folder, _, names in os.walk(top, onerror=failed if top.exists() else None):
                for name in names:
                    path = Path(folder, name)
                    try:
                        status = path.lstat()
                    except FileNotFoundError:  # it was removed, or renamed to its final name
                        continue
                    if stat.S_ISREG(status.st_mode) and not name.startswith(PREFIX):
                        yield _described(path.relative_to(self._folder).as_posix(), status)

    def head(self, key: str) -> StoredObject:
        """Return size, etag and time of the file `key`."""
        with self._told(key), self._opened(key) as descriptor:
            return _described(key, os.fstat(descriptor))

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        """Return bytes `begin` to `end` - 1 of `found`; raise ObjectChanged if it was changed."""
        key = found.key
        with self._told(key), self._opened(key) as descriptor:
            if _described(key, os.fstat(descriptor)) != found:
                raise changed(self._where(key))
            data = os.pread(descriptor, end - begin, begin) if begin < end else b""
            if len(data) != max(end - begin, 0):
                raise short_answer(self._where(key), len(data), end - begin)
            return data

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        """Store a file under an unused name; return whether it was stored."""
        with self._told(key), self._filled(key, parts, stamp) as path:
            try:
                _name_if_free(path, self._path(key))
            except FileExistsError:
                return False
            with suppress(OSError):  # some network file systems cannot
                sync_folder(path.parent)
            return True

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        """Store `parts` of any length as the file `key`; replace an existing file."""
        with self._told(key), self._filled(key, parts, stamp) as path:
            os.replace(path, self._path(key))
            with suppress(OSError):  # some network file systems cannot
                sync_folder(path.parent)

    @contextmanager
    def _opened(self, key: str) -> Iterator[int]:
        flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW
        descriptor = os.open(self._path(key), flags)
        try:
            mode = os.fstat(descriptor).st_mode
            if stat.S_ISDIR(mode):  # as in a bucket: a folder is no object
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
            if not stat.S_ISREG(mode):
                raise OSError(errno.EINVAL, "it is not a regular file")
            yield descriptor
        finally:
            os.close(descriptor)

    @contextmanager
    def _filled(self, key: str, parts: Iterable[bytes], stamp: Stamp) -> Iterator[Path]:
        """Yield the path of a temporary file with the content, already on the disk (fsync)."""
        folder = self._path(key).parent
        folder.mkdir(parents=True, exist_ok=True)
        remove_abandoned(folder, f"{PREFIX}*")
        with NamedTemporaryFile(dir=folder, prefix=PREFIX, delete=False) as file:
            try:
                file.writelines(parts)
                file.flush()
                if stamp.modified_ns:
                    os.utime(file.fileno(), ns=(stamp.modified_ns, stamp.modified_ns))
                os.fsync(file.fileno())
                yield Path(file.name)
            finally:
                with suppress(FileNotFoundError):  # it was renamed to its final name
                    os.unlink(file.name)

    @contextmanager
    def _told(self, key: str) -> Iterator[None]:
        try:
            yield
        except FileNotFoundError as error:
            raise NoSuchObject(f"{self._where(key)} does not exist") from error
        except PermissionError as error:
            raise AccessDenied(f"{self._where(key)}: {error.strerror}") from error
        except OSError as error:
            raise StoreFailed(f"{self._where(key)}: {error.strerror or error}") from error

    def _path(self, key: str) -> Path:
        check_key(key)
        path = self._folder / key
        if path.parent.resolve() != self._folder.resolve() / path.parent.relative_to(self._folder):
            raise StoreError(f"{self._where(key)} is behind a link", "name the folder itself")
        return path

    def _where(self, key: str) -> str:
        return f"{self.name}/{printable(key)}" if key else self.name


def _described(key: str, status: os.stat_result) -> StoredObject:
    # ctime as well: any program can set mtime to any value.
    etag = f"{status.st_ino}-{status.st_mtime_ns}-{status.st_ctime_ns}-{status.st_size}"
    return StoredObject(key, status.st_size, etag, status.st_mtime_ns)


def _name_if_free(path: Path, target: Path) -> None:
    """Link or rename a file to the new name `target`.

    Raises:
        FileExistsError: `target` exists.
        OSError: The file system has neither hard links nor a rename that replaces nothing.
    """
    try:
        os.link(path, target)
    except FileExistsError:
        raise
    except OSError:
        library = ctypes.CDLL(None, use_errno=True)
        names = _AT_FDCWD, os.fsencode(path), _AT_FDCWD, os.fsencode(target)
        if library.renameat2(*names, _RENAME_NOREPLACE):
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number), str(target)) from None
