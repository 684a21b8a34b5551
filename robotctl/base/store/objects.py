"""Objects by their keys: what every store offers, wherever it is, and what can go wrong."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, Protocol

from robotctl.base.errors import UnreadableFile
from robotctl.base.text import short_name

PART_BYTES: Final = 8 << 20
"""The parts of a large object that are sent at once; S3 allows 10,000 of at least 5 MiB."""

_MAX_KEY_BYTES = 1024


class StoreError(UnreadableFile):
    """A store that does not do what it is asked for; the base class of the errors below."""


class NoSuchObject(StoreError):
    """An object, a bucket or a folder that does not exist."""


class AccessDenied(StoreError):
    """A store that wants other credentials, or none that is there."""


class ObjectChanged(StoreError):
    """An object that changed since it was first read."""


class StoreFailed(StoreError):
    """A store that cannot be reached, or answers with an error, also after several tries."""


class BrokenAnswer(StoreFailed):
    """An answer that ended early."""


def changed(where: str) -> ObjectChanged:
    """Return the error for an object that has another content than before."""
    return ObjectChanged(f"{where} was changed while it was read", "run the command again")


def short_answer(where: str, got: int, wanted: int) -> BrokenAnswer:
    """Return the error for an answer of the wrong length [bytes]."""
    return BrokenAnswer(f"{where}: the store sent {got} of {wanted} bytes")


@dataclass(frozen=True, slots=True)
class StoredObject:
    """An object of a store, as it was at one moment."""

    key: str
    """Its path below the store, with slashes."""

    size_bytes: int
    etag: str
    """Changes with the content; its form is up to the store, and need not be a hash."""

    modified_ns: int = field(default=0, compare=False)
    """When its content was written, since the epoch; in a listing, when it was stored."""

    sha256: str = field(default="", compare=False)
    """The hash that was stored with it, "" if there is none; a listing has none."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """What is stored with an object: the hash of its content, and when that was written."""

    sha256: str = ""
    modified_ns: int = 0


NO_STAMP = Stamp()


def check_key(key: str) -> None:
    """Accept `a/b.mcap`, but nothing that leads out of a folder or that no store can hold.

    Raises:
        StoreError: It is no such name.
    """
    harmless = key.isprintable() and len(key.encode(errors="replace")) <= _MAX_KEY_BYTES
    if not harmless or any(part in ("", ".", "..") for part in key.split("/")):
        raise StoreError(f"no object can have the name '{short_name(key)}'")


class ObjectStore(Protocol):
    """A bucket, or a part of it below a prefix, or a folder. For threads: one call at a time each.

    Every method raises StoreError, and KeyboardInterrupt at once. A request that fails is repeated
    for at most half a minute.
    """

    @property
    def name(self) -> str:
        """Return the URL or the folder, for messages; it holds no credentials."""

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        """Yield the objects below the folder `prefix`, and below its folders, in no order."""

    def head(self, key: str) -> StoredObject:
        """Return what is known about an object.

        Raises:
            NoSuchObject: There is none of that name.
        """

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        """Return exactly the bytes from `begin` to before `end` of the object that was found.

        Raises:
            ObjectChanged: It has another content now.
            NoSuchObject: It does not exist any more.
        """

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        """Store an object under a free name, as `put` does; return whether it was free.

        False may also mean that a first try succeeded whose answer was lost: compare the contents
        if that makes a difference.
        """

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        """Store an object from parts of any length, and replace one of that name.

        It appears when all its parts are there. If `parts` raises, nothing is stored, and the error
        is raised here.
        """
