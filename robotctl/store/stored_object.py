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

    modified_s: float = field(default=0.0, compare=False)
    """When it was stored, since the epoch; a listing may tell more digits than the object."""


def check_key(key: str) -> None:
    """Accept `a/b.mcap`, but nothing that leads out of a folder or that no store can hold.

    Raises:
        StoreError: It is no such name.
    """
    harmless = key.isprintable() and len(key.encode(errors="replace")) <= _MAX_KEY_BYTES
    if not harmless or any(part in ("", ".", "..") for part in key.split("/")):
        raise StoreError(f"no object can have the name '{short_name(key)}'")
