"""What is known about an object without reading it, and which names objects may have."""

from __future__ import annotations

from dataclasses import dataclass, field

from robotctl.printable import short_name
from robotctl.store.store_errors import StoreError

_MAX_KEY_BYTES = 1024


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
