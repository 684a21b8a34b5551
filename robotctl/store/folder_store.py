"""A folder as a store: the same calls, the standard library alone."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from robotctl.printable import printable
from robotctl.store.failed_request import changed, short_answer
from robotctl.store.store_errors import (
    AccessDenied,
    NoSuchObject,
    StoreError,
    StoreFailed,
    TooLarge,
)
from robotctl.store.stored_object import NO_STAMP, Stamp, StoredObject, check_key
from robotctl.store.unfinished_file import PREFIX, UnfinishedFile, unfinished_file


class FolderStore:
    """The files below a folder; see `ObjectStore`. Links below it are not followed.

    The folder is created when something is stored.
    """

    can_list: Final = True

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def name(self) -> str:
        """Return the folder."""
        return printable(self._folder)

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Yield the files below the folder `prefix`, and below its folders."""
        top = self._path(prefix) if prefix else self._folder

        def failed(error: OSError) -> None:
            raise error

        with self._told(prefix):
            for folder, _, names in os.walk(top, onerror=failed if top.exists() else None):
                for name in names:
                    path = Path(folder, name)
                    try:
                        status = path.lstat()
                    except FileNotFoundError:  # it was removed, or has its name now
                        continue
                    if stat.S_ISREG(status.st_mode) and not name.startswith(PREFIX):
                        yield _described(path.relative_to(self._folder).as_posix(), status)

    def head(self, key: str) -> StoredObject:
        """Return what is known about a file."""
        with self._told(key), self._opened(key) as descriptor:
            return _described(key, os.fstat(descriptor))

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        """Return exactly the bytes from `begin` to before `end` of the file that was found."""
        key = found.key
        with self._told(key), self._opened(key) as descriptor:
            if _described(key, os.fstat(descriptor)) != found:
                raise changed(self._where(key))
            data = os.pread(descriptor, end - begin, begin) if begin < end else b""
            if len(data) != max(end - begin, 0):
                raise short_answer(self._where(key), len(data), end - begin)
            return data

    def start_range(self, found: StoredObject, begin: int, end: int) -> Future[bytes]:
        """Do what `get_range` does, and return its result as one to come."""
        result: Future[bytes] = Future()
        try:
            result.set_result(self.get_range(found, begin, end))
        except StoreError as error:
            result.set_exception(error)
        return result

    def get(self, key: str, max_bytes: int) -> bytes:
        """Return a whole file."""
        found = self.head(key)
        if found.size_bytes > max_bytes:
            raise TooLarge(f"{self._where(key)} has {found.size_bytes} bytes: that is too many")
        return self.get_range(found, 0, found.size_bytes)

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        """Store a file under a free name; return whether it was free."""
        with self._told(key), self._filled(key, parts, stamp) as file:
            try:
                file.name_if_free(self._path(key))
            except FileExistsError:
                return False
            return True

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        """Store a file from parts of any length, and replace one of that name."""
        with self._told(key), self._filled(key, parts, stamp) as file:
            file.name_over(self._path(key))

    def delete(self, key: str) -> None:
        """Remove a file; one that does not exist is no error."""
        with self._told(key), suppress(FileNotFoundError):
            self._path(key).unlink()

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
    def _filled(self, key: str, parts: Iterable[bytes], stamp: Stamp) -> Iterator[UnfinishedFile]:
        folder = self._path(key).parent
        folder.mkdir(parents=True, exist_ok=True)
        with unfinished_file(folder) as file:
            for part in parts:
                file.write(part)
            file.modified_ns = stamp.modified_ns
            yield file

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
    # The time of change as well: that of modification can be set to any value.
    etag = f"{status.st_ino}-{status.st_mtime_ns}-{status.st_ctime_ns}-{status.st_size}"
    return StoredObject(key, status.st_size, etag, status.st_mtime_ns)
