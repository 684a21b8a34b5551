"""The folders in which `robotctl sync` keeps files: RECORDING/SHA256/FILE."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Final

_HASH: Final = re.compile(r"[0-9a-f]{64}")
_HASH_FOLDER: Final = re.compile(r"(?<![^/])[0-9a-f]{64}/")

_LOOKED_AT: Final = 3
"""The number of recordings that are looked into; in a folder of copies the first is enough."""


def without_hashes(key: str) -> str:
    """Return the name of an object without its folder that is named by a hash."""
    return _HASH_FOLDER.sub("", key)


def hash_in(key: str) -> str:
    """Return the hash that names the folder of an object, "" if there is none."""
    found = _HASH_FOLDER.search(key)
    return "" if found is None else found[0].rstrip("/")


def has_hash_folders(path: Path) -> bool:
    """Return whether a folder holds such folders, or recordings that do."""
    return _has_hash_folder(path) or any(map(_has_hash_folder, _first_folders(path)))


def is_hash(name: str) -> bool:
    """Return whether a folder of this name is one of them."""
    return _HASH.fullmatch(name) is not None


def _has_hash_folder(path: Path | str) -> bool:
    with suppress(OSError), os.scandir(path) as found:
        return any(is_hash(each.name) and each.is_dir(follow_symlinks=False) for each in found)
    return False


def _first_folders(path: Path) -> list[str]:
    """Return the first folders in a folder, without hidden ones; none if it cannot be listed."""
    with suppress(OSError), os.scandir(path) as found:
        folders = (
            each.path
            for each in found
            if not each.name.startswith(".") and each.is_dir(follow_symlinks=False)
        )
        return list(islice(folders, _LOOKED_AT))
    return []
