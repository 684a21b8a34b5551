"""Objects in a bucket, on a web server or in a folder. URLs need obstore; nothing here needs ROS.

store = open_store("s3://bucket/robots/one")
for found in store.list():
    store.get_range(found, 0, 100)
"""

from __future__ import annotations

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
from robotctl.store.stored_object import StoredObject
from robotctl.store.url import is_url

__all__ = [
    "PART_BYTES",
    "AccessDenied",
    "NoSuchObject",
    "ObjectChanged",
    "ObjectStore",
    "StoreError",
    "StoreFailed",
    "StoredObject",
    "TooLarge",
    "is_url",
    "open_store",
]
