"""Objects in a bucket, on a web server or in a folder. URLs need obstore; nothing here needs ROS.

store = open_store("s3://bucket/robots/one")
for found in store.list():
    store.get_range(found, 0, 100)

The modules `bucket` and `folder_store` are loaded when a store is opened.
"""

from __future__ import annotations

from pathlib import Path

from robotctl.base.store.objects import (
    PART_BYTES,
    AccessDenied,
    NoSuchObject,
    ObjectChanged,
    ObjectStore,
    Stamp,
    StoredObject,
    StoreError,
    StoreFailed,
)
from robotctl.base.store.url import (
    has_hash_folders,
    hash_in,
    is_hash,
    is_url,
    parse_url,
    without_hashes,
)

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
    "has_hash_folders",
    "hash_in",
    "is_hash",
    "is_url",
    "open_store",
    "parse_url",
    "without_hashes",
]


def open_store(place: str) -> ObjectStore:
    """Open a URL or a folder as a store of the objects below it.

    No request is sent yet: the first call of a method shows whether the store exists. Credentials
    come from the environment, such as AWS_ACCESS_KEY_ID and AWS_ENDPOINT_URL.

    Raises:
        UsageError: The URL is wrong or not that of a store, or obstore is not installed.
    """
    from robotctl.base.store.folder_store import FolderStore

    if not is_url(place):
        return FolderStore(Path(place))
    url = parse_url(place)
    if url.scheme == "file":
        return FolderStore(Path("/", url.path))
    from robotctl.base.store.bucket import RemoteStore

    return RemoteStore(url)
