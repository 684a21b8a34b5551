"""Objects by key: the interface of every store (folder, bucket, web server), and its errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, Protocol

from robotctl.base.errors import UnreadableFile
from robotctl.base.text import short_name

PART_BYTES: Final = 8 << 20
"""The part size of a multipart upload; S3 allows 10,000 parts of at least 5 MiB."""

_MAX_KEY_BYTES = 1024


class StoreError(UnreadableFile):
    """A store did not carry out a request; the base class of the errors below."""


class NoSuchObject(StoreError):
    """An object, a bucket or a folder does not exist."""


class AccessDenied(StoreError):
    """A store denied access: the credentials are wrong, or there are none."""


class ObjectChanged(StoreError):
    """An object has changed since its first read."""


class StoreFailed(StoreError):
    """A store cannot be reached or answers with an error, even after retries."""


class BrokenAnswer(StoreFailed):
    """A server's answer ended before its last byte."""


def changed(where: str) -> ObjectChanged:
    """Return the error for an object whose content changed while it was read."""
    return ObjectChanged(f"{where} was changed while it was read", "run the command again")


def short_answer(where: str, got: int, wanted: int) -> BrokenAnswer:
    """Return the error for an answer of `got` instead of `wanted` bytes."""
    return BrokenAnswer(f"{where}: the store sent {got} of {wanted} bytes")


@dataclass(frozen=True, slots=True)
class StoredObject:
    """What a store reported about an object at one moment."""

    key: str
    """The path of the object below the store, with slashes."""

    size_bytes: int
    etag: str
    """Text that changes when the content changes; each store has its own format."""

    modified_ns: int = field(default=0, compare=False)
    """When the content was written, since the epoch; in a bucket's listing, when it was stored."""

    sha256: str = field(default="", compare=False)
    """The hash that was stored with the object; "" if there is none, or in a listing."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """Metadata to store with an object: the content's SHA-256, and when the content was written."""

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
        """Return size, etag, time and stored hash of an object.

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
        """Store an object as `put` does, unless the key is in use; return whether it was stored.

        The result is also False if the object was stored, but the server's answer was lost.
        """

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        """Store an object from parts of any length; replace the object that has that key.

        The object appears when all parts are stored. If iterating `parts` raises an exception,
        nothing is stored, and `put` raises that exception.
        """
