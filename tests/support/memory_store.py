"""A store of objects in memory, which a test lets fail."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence

from robotctl.base.store import NoSuchObject, ObjectChanged, ObjectStore, Stamp, StoredObject


def works(request: str, key: str) -> None:
    """Let every request succeed."""


NO_STAMP = Stamp()


def content(store: ObjectStore, key: str) -> bytes:
    """Return a whole object."""
    found = store.head(key)
    return store.get_range(found, 0, found.size_bytes)


class MemoryStore:
    """An `ObjectStore`; `before(request, key)` is called at each request and may raise."""

    name = "memory"

    def __init__(self, before: Callable[[str, str], None] = works) -> None:
        self.objects: dict[str, bytes] = {}
        self.stamps: dict[str, Stamp] = {}
        self.requests: list[tuple[str, str]] = []
        self.before = before

    def _request(self, request: str, key: str) -> None:
        self.requests.append((request, key))
        self.before(request, key)

    def list(self, prefix: str = "") -> Iterator[StoredObject]:
        self._request("list", prefix)
        for key in list(self.objects):
            if not prefix or key.startswith(f"{prefix}/"):
                yield self._described(key)

    def head(self, key: str) -> StoredObject:
        self._request("head", key)
        return self._described(key)

    def get_range(self, found: StoredObject, begin: int, end: int) -> bytes:
        self._request("get", found.key)
        if self._described(found.key) != found:
            raise ObjectChanged(f"memory/{found.key} was changed while it was read")
        return self.objects[found.key][begin:end]

    def put_if_absent(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> bool:
        data = b"".join(parts)
        if key in self.objects:
            self._request("put", key)
            return False
        self._store(key, data, stamp)
        return True

    def put(self, key: str, parts: Iterable[bytes], stamp: Stamp = NO_STAMP) -> None:
        self._store(key, b"".join(parts), stamp)

    def _store(self, key: str, data: bytes, stamp: Stamp) -> None:
        self._request("put", key)
        self.objects[key], self.stamps[key] = data, stamp

    def puts(self) -> Sequence[str]:
        """Return the keys of all requests that stored something."""
        return [key for request, key in self.requests if request == "put"]

    def _described(self, key: str) -> StoredObject:
        if key not in self.objects:
            raise NoSuchObject(f"memory/{key} does not exist")
        content = self.objects[key]
        stamp = self.stamps.get(key, NO_STAMP)
        etag = hashlib.sha1(content).hexdigest()
        return StoredObject(key, len(content), etag, stamp.modified_ns, stamp.sha256)
