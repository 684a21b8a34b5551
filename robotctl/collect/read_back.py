"""Reads objects of a store whose content must be what their name says."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Final

from robotctl.collect.manifest import MAX_MANIFEST_BYTES, Manifest
from robotctl.collect.object_names import CollectedRecording, ObjectName
from robotctl.errors import Divergence
from robotctl.store import ObjectStore

READ_BYTES: Final = 8 << 20
"""How much is read back at once."""


class WrongContent(Divergence):
    """An object of a store that does not hold what its name says."""


def read_manifest(store: ObjectStore, recording: CollectedRecording) -> Manifest:
    """Return the newest manifest of a recording.

    Raises:
        StoreError: The store fails.
        WrongContent: The content does not match the name.
        UnreadableFile: There is no manifest, or it is not valid.
    """
    name = recording.manifest
    assert name is not None, "a recording without a manifest"
    text = store.get(name.key, MAX_MANIFEST_BYTES)
    if hashlib.sha256(text).hexdigest() != name.sha256:
        raise wrong_content(store, name)
    return Manifest.from_bytes(text)


def check_content(
    store: ObjectStore, name: ObjectName, size_bytes: int, pace: Callable[[int], None]
) -> None:
    """Read an object back, and compare its size and its hash with those it must have.

    Raises:
        StoreError: It is not there, or the store fails.
        WrongContent: It holds something else.
    """
    found = store.head(name.key)
    if found.size_bytes != size_bytes:
        raise wrong_content(store, name)
    digest = hashlib.sha256()
    for begin in range(0, size_bytes, READ_BYTES):
        end = min(begin + READ_BYTES, size_bytes)
        pace(end - begin)
        digest.update(store.get_range(found, begin, end))
    if digest.hexdigest() != name.sha256:
        raise wrong_content(store, name)


def wrong_content(store: ObjectStore, name: ObjectName) -> WrongContent:
    """Return the error for an object that is not what its name says."""
    return WrongContent(
        f"{store.name}/{name.key} does not hold what its name says",
        "something else has changed it: what is here stays; remove the object to copy it again",
    )
