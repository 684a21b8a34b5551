"""Opens the store that a user names."""

from __future__ import annotations

from pathlib import Path

from robotctl.store.folder_store import FolderStore
from robotctl.store.object_store import ObjectStore
from robotctl.store.url import is_url, parse_url


def open_store(place: str) -> ObjectStore:
    """Open a URL or a folder; its objects are those below it.

    Nothing is asked of a store yet: whether it exists, the first call tells. Credentials come from
    the environment, as AWS_ACCESS_KEY_ID and AWS_ENDPOINT_URL.

    Raises:
        UsageError: It is no URL of a store, or what URLs need is not installed.
    """
    if not is_url(place):
        return FolderStore(Path(place))
    url = parse_url(place)
    if url.scheme == "file":
        return FolderStore(Path("/", url.path))
    from robotctl.store.remote_store import RemoteStore

    return RemoteStore(url)
