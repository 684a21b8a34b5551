"""Objects in a bucket, on a web server or in a folder. URLs need obstore; nothing here needs ROS.

store = open_store("s3://bucket/robots/one")
for found in store.list():
    store.get_range(found, 0, 100)
"""

from __future__ import annotations

import os
import stat
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path, PosixPath
from shlex import quote
from typing import Any, Final, Self

from robotctl.base.errors import UsageError
from robotctl.base.store.objects import ObjectStore, StoredObject, StoreError, is_url, parse_url

SUFFIX: Final = ".mcap"

_LEAST_BYTES: Final = 64 << 10
"""The smallest range to request."""

_MOST_BYTES: Final = 4 << 20
"""The largest range to request of a file that is read from start to end."""

_KEPT_RANGES: Final = 8

MAX_READ_BYTES: Final = 1 << 30
"""The limit of one `read`; no part of a valid recording is larger."""


def path_of(text: str) -> Path:
    """Return `text`, a path on this computer or the URL of an MCAP file, as a Path.

    Raises:
        UsageError: The URL is not the URL of an MCAP file, or its scheme is not supported.
    """
    if not is_url(text):
        return Path(text)
    url = parse_url(text)
    if url.scheme == "file":
        if url.host not in ("", "localhost"):  # RFC 8089
            raise UsageError(
                f"{text} is a file of the computer {url.host!r}, which is not this one"
            )
        return Path("/", url.path)
    if not url.name.endswith(SUFFIX):
        raise not_here(str(url))
    return RemoteFile(str(url))


def not_here(url: str) -> UsageError:
    """Return the error for a URL given to a command that needs files on this computer."""
    return UsageError(f"{url} is not on this computer", f"first robotctl sync {quote(url)} DIR")


class RemoteFile(PosixPath):
    """The path of an MCAP file at a URL. Reads fail if the file changes after the first request."""

    _found: StoredObject | None = None
    _reader: RangeReader | None = None

    def __str__(self) -> str:
        """Return the URL."""
        return super().__str__().replace(":/", "://", 1)

    def reader(self) -> RangeReader:
        """Return the reader, which caches recent ranges of the file.

        Raises:
            StoreError: There is no such file, or the store fails.
        """
        if self._reader is None:
            found = self._described()
            self._reader = RangeReader(found.size_bytes, partial(self._store().get_range, found))
        return self._reader

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """Return the file type and the size; the other fields have no meaning.

        Raises:
            StoreError: There is no such file, or the store fails.
        """
        size = self._described().size_bytes
        return os.stat_result((stat.S_IFREG, 0, 0, 1, 0, 0, size, 0, 0, 0))

    def is_file(self, **_: Any) -> bool:
        """Return True: the URL names a file."""
        return True

    def is_dir(self, **_: Any) -> bool:
        """Return False: the URL names a file."""
        return False

    def is_symlink(self) -> bool:
        """Return False: a store has no links."""
        return False

    def absolute(self) -> Self:
        """Return this path: a URL is always absolute."""
        return self

    def resolve(self, strict: bool = False) -> Self:
        """Return this path: a URL has no links to resolve."""
        return self

    def _store(self) -> ObjectStore:
        return open_store(str(parse_url(str(self)).parent))

    def _described(self) -> StoredObject:
        if self._found is None:
            self._found = self._store().head(self.name)
        return self._found


class RangeReader:
    """Reads ranges of one object, and caches the most recent ranges. Use it from one thread."""

    def __init__(self, size: int, fetch: Callable[[int, int], bytes]) -> None:
        """`fetch(begin, end)` returns the bytes from `begin` up to, but not including, `end`."""
        self._size = size
        self._fetch = fetch
        self._kept: deque[tuple[int, bytes]] = deque(maxlen=_KEPT_RANGES)
        self._window = _LEAST_BYTES
        self._next = 0
        self._failure: StoreError | None = None

    def read(self, offset: int, length: int) -> bytes:
        """Return `length` bytes at `offset`; return fewer only at the end of the object.

        Raises:
            StoreError: `length` is too large, or a request failed in this or an earlier call.
        """
        if self._failure is not None:
            raise self._failure
        if length > MAX_READ_BYTES:
            raise StoreError(f"a part of it claims to have {length} bytes")
        end = min(offset + length, self._size)
        pieces = []
        while offset < end:
            begin, data = self._holding(offset) or self._asked(offset, end)
            pieces.append(data[offset - begin : end - begin])
            offset = begin + len(data)
        return b"".join(pieces)

    def _holding(self, offset: int) -> tuple[int, bytes] | None:
        held = (each for each in self._kept if each[0] <= offset < each[0] + len(each[1]))
        return next(held, None)

    def _asked(self, offset: int, end: int) -> tuple[int, bytes]:
        """Fetch a range that includes `offset`; return its begin and its content."""
        follows = offset == self._next
        self._window = min(2 * self._window, _MOST_BYTES) if follows else _LEAST_BYTES
        end = min(max(end, offset + self._window), self._size)
        begin = min(offset, max(end - _LEAST_BYTES, 0))  # the end is read backwards
        try:
            data = self._fetch(begin, end)
        except StoreError as error:
            self._failure = error
            raise
        self._next = end
        self._kept.append((begin, data))
        return begin, data


def open_store(place: str) -> ObjectStore:
    """Open a URL or a folder as a store of the objects below it.

    No request is sent yet. Credentials come from the environment, such as AWS_ACCESS_KEY_ID.

    Raises:
        UsageError: The URL is wrong or not that of a store, or obstore is not installed.
    """
    from robotctl.base.store.folder_store import FolderStore

    if not is_url(place):
        return FolderStore(Path(place))
    url = parse_url(place)
    if url.scheme == "file":
        return FolderStore(Path("/", url.path))
    from robotctl.base.store.bucket import RemoteStore

    return RemoteStore(url)
