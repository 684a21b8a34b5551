"""The interface of every store, its errors, and URLs. Standard library only.

The keys of recordings are RECORDING/FILE, or RECORDING/SHA256/FILE from an earlier `sync`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Final, Protocol
from urllib.parse import unquote, urlsplit

from robotctl.base.errors import UnreadableFile, UsageError
from robotctl.base.text import short_name

PART_BYTES: Final = 8 << 20
"""The part size of a multipart upload; S3 allows 10,000 parts of at least 5 MiB."""

_MAX_KEY_BYTES = 1024


class StoreError(UnreadableFile):
    """A store did not carry out a request."""


class NoSuchObject(StoreError):
    """An object, a bucket or a folder does not exist."""


class AccessDenied(StoreError):
    """A store denied access because of wrong or missing credentials."""


class ObjectChanged(StoreError):
    """An object has changed since its first read."""


class StoreFailed(StoreError):
    """A store cannot be reached or answers with an error, even after retries."""


class BrokenAnswer(StoreFailed):
    """A server's answer ended before its last byte."""


def changed(where: str) -> ObjectChanged:
    """Return the error for an object that changed while it was read."""
    return ObjectChanged(f"{where} was changed while it was read", "run the command again")


def short_answer(where: str, got: int, wanted: int) -> BrokenAnswer:
    """Return the error for an answer of `got` instead of `wanted` bytes."""
    return BrokenAnswer(f"{where}: the store sent {got} of {wanted} bytes")


@dataclass(frozen=True, slots=True)
class StoredObject:
    """Key, size, etag, time and hash of an object, as its store described it at one moment."""

    key: str
    """The path of the object below the store, with slashes."""

    size_bytes: int
    etag: str
    """Text that changes with the content, in the store's own format."""

    modified_ns: int = field(default=0, compare=False)
    """The time of writing since the epoch; in a bucket's listing, the time of storing."""

    sha256: str = field(default="", compare=False)
    """The stored hash of the object; "" if there is none, or in a listing."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """Metadata to store with an object: the hash of its content, and its time of writing [ns]."""

    sha256: str = ""
    modified_ns: int = 0


NO_STAMP = Stamp()


def check_key(key: str) -> None:
    """Check that `key` is a printable relative path such as `a/b.mcap`, without `.` and `..`.

    Raises:
        StoreError: `key` is no such path, or it is too long for a store.
    """
    harmless = key.isprintable() and len(key.encode(errors="replace")) <= _MAX_KEY_BYTES
    if not harmless or any(part in ("", ".", "..") for part in key.split("/")):
        raise StoreError(f"no object can have the name '{short_name(key)}'")


class ObjectStore(Protocol):
    """A folder, a bucket, or the part of a bucket below a prefix. Threads may share it.

    Every method may raise StoreError. Ctrl-C ends a call at once. Failed requests to a server are
    retried for about 20 s.
    """

    @property
    def name(self) -> str:
        """Return the URL or folder for messages, without credentials."""

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Yield the objects below the folder `prefix`, at any depth, in no particular order."""

    def head(self, key: str) -> StoredObject:
        """Return size, etag, time and stored hash of the object `key`.

        Raises:
            NoSuchObject: There is no object with that key.
        """

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        """Return bytes `begin` to `end` (excluded) of the object that `found` describes.

        Raises:
            ObjectChanged: The object's content has changed since `found` was made.
            NoSuchObject: The object does not exist any more.
        """

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        """Store an object under an unused key; return whether it was stored.

        The result is also False if the object was stored, but the server's answer was lost.
        """

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        """Store `parts` of any length as the object `key`, in place of an existing one.

        The object appears when all parts are stored; if `parts` raises an exception, nothing is
        stored.
        """


_URL: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")

SCHEMES: Final = ("s3", "gs", "az", "https", "http", "file")
_WEB: Final = ("https", "http", "file")
"""Schemes with percent-encoded URLs; in the others, a key is written as it is."""

_HASH: Final = re.compile(r"[0-9a-f]{64}")
_HASH_FOLDER: Final = re.compile(r"(?<![^/])[0-9a-f]{64}/")

_LOOKED_AT: Final = 3
"""The number of subfolders that are searched for copies."""


@dataclass(frozen=True, slots=True)
class StoreUrl:
    """The parts of the URL of a store or an object, without credentials."""

    scheme: str
    host: str
    """Host with port, or the bucket."""

    path: str
    """The key of an object, or a prefix of keys; no slash at either end."""

    def __str__(self) -> str:
        return f"{self.root}/{self.path}".rstrip("/")

    @property
    def root(self) -> str:
        """Return the URL of the whole bucket or server."""
        return f"{self.scheme}://{self.host}"

    @property
    def parent(self) -> StoreUrl:
        """Return the URL of the folder that contains this object."""
        return StoreUrl(self.scheme, self.host, self.path.rpartition("/")[0])

    @property
    def name(self) -> str:
        """Return the last part of the path; empty for a whole bucket."""
        return self.path.rpartition("/")[2]


def is_url(text: str) -> bool:
    """Return whether `text` begins with SCHEME://."""
    return _URL.match(text) is not None


def parse_url(text: str) -> StoreUrl:
    """Return the parts of the URL `text`.

    Raises:
        UsageError: `text` is no URL of a store; the error never contains a password.
    """
    scheme = text.partition("://")[0].lower()
    if not is_url(text) or scheme not in SCHEMES:
        known = ", ".join(f"{each}://" for each in SCHEMES)
        raise UsageError(f"'{short_name(scheme)}://' is no kind of store", f"there are {known}")
    host, _, path = text.partition("://")[2].partition("/")
    if "@" in host:
        raise UsageError("a URL must not hold a password", "set it in the environment")
    if scheme in _WEB:
        parts = urlsplit(text)
        if parts.query or parts.fragment:
            raise UsageError("a URL with '?' or '#' cannot be read", "download the file first")
        path = unquote(path)
    if (not host and scheme != "file") or not (host + path).isprintable():
        raise UsageError(f"{scheme}:// needs the name of a bucket or a server")
    return StoreUrl(scheme, host, path.strip("/"))


def without_hashes(key: str) -> str:
    """Return the key without folders that are named by a SHA-256."""
    return _HASH_FOLDER.sub("", key)


def hash_in(key: str) -> str:
    """Return the SHA256 in `key` if its form is RECORDING/SHA256/FILE, else ""."""
    found = _HASH_FOLDER.search(key)
    return "" if found is None else found[0].rstrip("/")


def has_hash_folders(path: Path) -> bool:
    """Return whether `path` or one of its first three folders has a folder named by a SHA-256."""
    return _has_hash_folder(path) or any(map(_has_hash_folder, _first_folders(path)))


def is_hash(name: str) -> bool:
    """Return whether `name` is a SHA-256 in hexadecimal."""
    return _HASH.fullmatch(name) is not None


def _has_hash_folder(path: Path | str) -> bool:
    with suppress(OSError), os.scandir(path) as found:
        return any(is_hash(each.name) and each.is_dir(follow_symlinks=False) for each in found)
    return False


def _first_folders(path: Path) -> list[str]:
    """Return the first subfolders that are not hidden, none if `path` is unreadable."""
    with suppress(OSError), os.scandir(path) as found:
        folders = (
            each.path
            for each in found
            if not each.name.startswith(".") and each.is_dir(follow_symlinks=False)
        )
        return list(islice(folders, _LOOKED_AT))
    return []
