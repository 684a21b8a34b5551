"""Objects by their keys: what every store offers, wherever it is."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, Protocol

from robotctl.store.stored_object import NO_STAMP, Stamp, StoredObject

PART_BYTES: Final = 8 << 20
"""The parts of a large object that are sent at once; S3 allows 10,000 of at least 5 MiB."""


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

    def get(self, key: str, max_bytes: int) -> bytes:
        """Return a whole object.

        Raises:
            NoSuchObject: There is none of that name.
            TooLarge: It has more than `max_bytes`.
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

    def delete(self, key: str) -> None:
        """Remove an object; one that does not exist is no error."""
