"""Objects in a bucket, on a web server or in a folder. URLs need obstore; nothing here needs ROS.

store = open_store("s3://bucket/robots/one")
for found in store.list():
    store.get_range(found, 0, 100)

Each name is loaded on first use: a command that only asks whether a path is a URL loads little.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.store.hash_folders import has_hash_folders, hash_in, without_hashes
    from robotctl.store.object_store import PART_BYTES, ObjectStore
    from robotctl.store.opening import open_store
    from robotctl.store.store_errors import (
        AccessDenied,
        NoSuchObject,
        ObjectChanged,
        StoreError,
        StoreFailed,
        TooLarge,
    )
    from robotctl.store.stored_object import Stamp, StoredObject
    from robotctl.store.url import is_url, parse_url

__all__ = [
    "PART_BYTES",
    "AccessDenied",
    "NoSuchObject",
    "ObjectChanged",
    "ObjectStore",
    "Stamp",
    "StoreError",
    "StoreFailed",
    "StoredObject",
    "TooLarge",
    "has_hash_folders",
    "hash_in",
    "is_url",
    "open_store",
    "parse_url",
    "without_hashes",
]

_NAMES_OF_MODULE = {
    "hash_folders": ("has_hash_folders", "hash_in", "without_hashes"),
    "object_store": ("ObjectStore", "PART_BYTES"),
    "opening": ("open_store",),
    "store_errors": (
        "AccessDenied",
        "NoSuchObject",
        "ObjectChanged",
        "StoreError",
        "StoreFailed",
        "TooLarge",
    ),
    "stored_object": ("Stamp", "StoredObject"),
    "url": ("is_url", "parse_url"),
}
_MODULES = {name: module for module, names in _NAMES_OF_MODULE.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
