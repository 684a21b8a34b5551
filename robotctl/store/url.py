"""What users write for a store: a URL, or a folder. Standard library only."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final
from urllib.parse import unquote, urlsplit

from robotctl.errors import UsageError
from robotctl.printable import short_name

_URL: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")

SCHEMES: Final = ("s3", "gs", "az", "https", "http", "file")
_WEB: Final = ("https", "http", "file")
"""Those in whose URLs `%20` is a space; an object's name is written as it is."""


@dataclass(frozen=True, slots=True)
class StoreUrl:
    """The parts of a URL without credentials."""

    scheme: str
    host: str
    """Host with port, or the bucket."""

    path: str
    """The name of an object, or the beginning of names, without slashes at its ends."""

    def __str__(self) -> str:
        return f"{self.root}/{self.path}".rstrip("/")

    @property
    def root(self) -> str:
        """Return the URL of the whole bucket or server."""
        return f"{self.scheme}://{self.host}"

    @property
    def parent(self) -> StoreUrl:
        """Return the URL of the folder that holds this object."""
        return StoreUrl(self.scheme, self.host, self.path.rpartition("/")[0])

    @property
    def name(self) -> str:
        """Return the last part of the path; empty for a whole bucket."""
        return self.path.rpartition("/")[2]


def is_url(text: str) -> bool:
    """Return whether a user wrote a URL and no path; it need not be a valid one."""
    return _URL.match(text) is not None


def parse_url(text: str) -> StoreUrl:
    """Return the parts of a URL.

    Raises:
        UsageError: It is no URL of a store; the text does not repeat what may be a password.
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
