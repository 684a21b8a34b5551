"""The URL of a store as users write it, and the keys of copied recordings: RECORDING/FILE.

An earlier `robotctl sync` made keys of the form RECORDING/SHA256/FILE. Standard library only.
"""

from __future__ import annotations

import os
import re
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final
from urllib.parse import unquote, urlsplit

from robotctl.base.errors import UsageError
from robotctl.base.text import short_name

_URL: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")

SCHEMES: Final = ("s3", "gs", "az", "https", "http", "file")
_WEB: Final = ("https", "http", "file")
"""Schemes whose URLs are percent-encoded; in the others, a key is written as it is."""

_HASH: Final = re.compile(r"[0-9a-f]{64}")
_HASH_FOLDER: Final = re.compile(r"(?<![^/])[0-9a-f]{64}/")

_LOOKED_AT: Final = 3
"""How many subfolders are searched for copies, in case the first ones contain other files."""


@dataclass(frozen=True, slots=True)
class StoreUrl:
    """The parts of the URL of a store or an object, without credentials."""

    scheme: str
    host: str
    """Host with port, or the bucket."""

    path: str
    """The key of an object, or a prefix of keys; no slash at either end."""

    def __str__(self) -> str:
        return f"{self.root}/{self.path}".rstrip("/")

    @property
    def root(self) -> str:
        """Return the URL of the whole bucket or server."""
        return f"{self.scheme}://{self.host}"

    @property
    def parent(self) -> StoreUrl:
        """Return the URL of the folder that contains this object."""
        return StoreUrl(self.scheme, self.host, self.path.rpartition("/")[0])

    @property
    def name(self) -> str:
        """Return the last part of the path; empty for a whole bucket."""
        return self.path.rpartition("/")[2]


def is_url(text: str) -> bool:
    """Return whether `text` begins with SCHEME://; the URL need not be valid."""
    return _URL.match(text) is not None


def parse_url(text: str) -> StoreUrl:
    """Return the parts of a URL.

    Raises:
        UsageError: `text` is no URL of a store; the error repeats nothing that may be a password.
    """
    scheme = text.partition("://")[0].lower()
    if not is_url(text) or scheme not in SCHEMES:
        known = ", ".join(f"{each}://" for each in SCHEMES)
        raise UsageError(f"'{short_name(scheme)}://' is no kind of store", f"there are {known}")
    host, _, path = text.partition("://")[2].partition("/")
    if "@" in host:
        raise UsageError("a URL must not hold a password", "set it in the environment")
    if scheme in _WEB:
        parts = urlsplit(text)
        if parts.query or parts.fragment:
            raise UsageError("a URL with '?' or '#' cannot be read", "download the file first")
        path = unquote(path)
    if (not host and scheme != "file") or not (host + path).isprintable():
        raise UsageError(f"{scheme}:// needs the name of a bucket or a server")
    return StoreUrl(scheme, host, path.strip("/"))


def without_hashes(key: str) -> str:
    """Return the key without folders that are named by a SHA-256."""
    return _HASH_FOLDER.sub("", key)


def hash_in(key: str) -> str:
    """Return the SHA256 in a key of the form RECORDING/SHA256/FILE, "" in any other."""
    found = _HASH_FOLDER.search(key)
    return "" if found is None else found[0].rstrip("/")


def has_hash_folders(path: Path) -> bool:
    """Return whether `path`, or one of the first folders in it, has a folder named by a SHA-256."""
    return _has_hash_folder(path) or any(map(_has_hash_folder, _first_folders(path)))


def is_hash(name: str) -> bool:
    """Return whether `name` is a SHA-256 in hexadecimal."""
    return _HASH.fullmatch(name) is not None


def _has_hash_folder(path: Path | str) -> bool:
    with suppress(OSError), os.scandir(path) as found:
        return any(is_hash(each.name) and each.is_dir(follow_symlinks=False) for each in found)
    return False


def _first_folders(path: Path) -> list[str]:
    """Return the first subfolders that are not hidden; an empty list if `path` is unreadable."""
    with suppress(OSError), os.scandir(path) as found:
        folders = (
            each.path
            for each in found
            if not each.name.startswith(".") and each.is_dir(follow_symlinks=False)
        )
        return list(islice(folders, _LOOKED_AT))
    return []
