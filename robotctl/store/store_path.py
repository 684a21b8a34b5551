"""A file or folder of a store as a path, so that what reads recordings reads them from there."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path, PosixPath, PurePosixPath
from typing import TYPE_CHECKING, Any, BinaryIO, Final, Self

from robotctl.errors import UsageError
from robotctl.regular_file import open_regular
from robotctl.store.hash_folders import has_hash_folders
from robotctl.store.range_reader import RangeReader
from robotctl.store.store_errors import AccessDenied
from robotctl.store.stored_object import StoredObject
from robotctl.store.url import is_url, parse_url

if TYPE_CHECKING:
    from robotctl.store.opened_bucket import OpenedBucket

_MAX_OPENED_BYTES: Final = 64 << 20
"""Of a file that is read as a whole, as `metadata.yaml`."""

_HOST_PARTS: Final = 2
"""Scheme and host, the first two parts of a path; of this computer the highest folder."""

_HERE: Final = "file:"
"""The scheme of this computer."""


def path_of(text: str) -> Path:
    """Return the path that a user means: of this computer, or of a store if it is a URL.

    A folder that `robotctl sync` has made is a store, too.

    Raises:
        UsageError: It is a URL, but of no store.
    """
    if not is_url(text):
        path = Path(text)
    else:
        url = parse_url(text)
        if url.scheme != "file":
            return StorePath(str(url))
        if url.host not in ("", "localhost"):  # RFC 8089
            raise UsageError(
                f"{text} is a file of the computer {url.host!r}, which is not this one"
            )
        path = Path("/", url.path)
    return StorePath(f"{_HERE}{path.resolve()}") if has_hash_folders(path) else path


def open_file(path: Path) -> BinaryIO:
    """Open a regular file of this computer, or a small one of a store, for reading.

    Raises:
        OSError: It cannot be opened, or is not a regular file.
        StoreError: The store fails.
    """
    return path.open() if isinstance(path, StorePath) else open_regular(path)


class StorePath(PosixPath):
    """A path below a URL. Where it is listed or read, the store is asked, once in a process.

    Folders that are named by a hash, as `robotctl sync` makes them, are left out of paths.

    What needs a file of this computer, and so uses the path as a name for the operating system,
    gets a UsageError.
    """

    def __str__(self) -> str:
        """Return the URL, or the path of this computer."""
        if self.parts[0] == _HERE:
            return str(Path("/", *self.parts[1:]))
        return super().__str__().replace(":/", "://", 1)

    def __fspath__(self) -> str:
        """Refuse to be a name of the operating system, unless the store is a folder."""
        if self.parts[0] == _HERE:
            found = self._found()
            return str(self) if found is None else str(Path("/", self.parts[1], found.key))
        raise UsageError(f"{self} is not on this computer, as this needs", "download it first")

    def reader(self) -> RangeReader:
        """Return what reads this file."""
        return self._bucket.reader(self._key)

    @property
    def store_root(self) -> str:
        """The URL or folder of the whole store, below which `described` names the file."""
        here = self.parts[0] == _HERE
        return f"/{self.parts[1]}" if here else f"{self.parts[0]}//{self.parts[1]}"

    def described(self) -> StoredObject:
        """Return what is known about this file.

        Raises:
            NoSuchObject: There is no such file.
        """
        found = self._found()
        if found is None:
            raise self._bucket.no_such(self._key)
        return found

    def check(self) -> None:
        """Raise what has kept this file, or one in this folder, from being read, if anything has.

        Raises:
            StoreError: The store has failed, or a file was changed or removed meanwhile.
        """
        self._bucket.check(self._key)

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """Return kind and size; the rest is zero.

        Raises:
            NoSuchObject: There is no such file, and no file below it.
        """
        found = self._found()
        if found is None and not self._below():
            raise self._bucket.no_such(self._key)
        mode = stat.S_IFDIR if found is None else stat.S_IFREG
        size = 0 if found is None else found.size_bytes
        return os.stat_result((mode, 0, 0, 1, 0, 0, size, 0, 0, 0))

    def exists(self, *, follow_symlinks: bool = True) -> bool:
        """Return whether it is a file or a folder."""
        return self.is_file() or self.is_dir()

    def is_file(self, **_: Any) -> bool:
        """Return whether it is a file."""
        return self._found() is not None

    def is_dir(self, **_: Any) -> bool:
        """Return whether it is a folder: there are files below it."""
        return self._found() is None and bool(self._below())

    def is_symlink(self) -> bool:
        """Return False."""
        return False

    def glob(self, pattern: str, **_: Any) -> Iterator[Self]:  # type: ignore[override]
        """Yield the files below it whose names match, as many parts as the pattern has."""
        parts = len(PurePosixPath(pattern).parts)
        for name in self._below():
            below = PurePosixPath(name)
            if len(below.parts) == parts and below.match(pattern):
                yield self / name

    def iterdir(self) -> Iterator[Self]:  # type: ignore[override]
        """Yield the files and folders in it."""
        for name in dict.fromkeys(below.partition("/")[0] for below in self._below()):
            yield self / name

    def open(self, *_: Any, **__: Any) -> BytesIO:  # type: ignore[override]
        """Return the content of a small file."""
        try:
            found = self._found()
        except AccessDenied:  # what some stores answer if it does not exist
            found = None
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        reader = self._bucket.reader(self._key)
        return BytesIO(reader.read(0, _MAX_OPENED_BYTES))

    def absolute(self) -> Self:
        """Return the path: it is absolute."""
        return self

    def resolve(self, strict: bool = False) -> Self:
        """Return the path: a store has no links."""
        return self

    @property
    def _bucket(self) -> OpenedBucket:
        from robotctl.store.opened_bucket import opened_bucket  # it loads asyncio

        return opened_bucket(f"{self.parts[0]}//{self.parts[1]}")

    @property
    def _key(self) -> str:
        return "/".join(self.parts[_HOST_PARTS:])

    def _found(self) -> StoredObject | None:
        return self._bucket.found(self._key) if self._key else None

    def _below(self) -> list[str]:
        return self._bucket.below(self._key)
