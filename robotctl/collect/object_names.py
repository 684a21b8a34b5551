"""How collected recordings lie in a store: RECORDING/SHA256/FILE.

The name of an object holds the hash of its content. So an object never changes: other content has
another name, and what a listing shows is what the store holds.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final, Self

from robotctl.store.stored_object import StoredObject

_NAME: Final = re.compile(r"[A-Za-z0-9_+=@-][A-Za-z0-9_.+=@-]*")
"""What every store takes, and what no shell, no URL and no file system changes."""

_SHA256: Final = re.compile(r"[0-9a-f]{64}")
_MANIFEST: Final = re.compile(r"manifest-(\d{6,18})\.json")


@dataclass(frozen=True, slots=True)
class ObjectName:
    """The name of an object: a file of a recording, such as `clips/a.mcap`, with its SHA-256."""

    recording: str
    sha256: str
    file: str

    @property
    def key(self) -> str:
        """The name in the store."""
        return f"{self.recording}/{self.sha256}/{self.file}"

    @property
    def manifest_number(self) -> int:
        """The number of a manifest; 0 for another file."""
        match = _MANIFEST.fullmatch(self.file)
        return int(match[1]) if match else 0

    @classmethod
    def parse(cls, key: str) -> Self | None:
        """Return what an object of the store is; None if its key is not RECORDING/SHA256/FILE."""
        recording, _, rest = key.partition("/")
        sha256, _, file = rest.partition("/")
        if not (is_plain(recording) and _SHA256.fullmatch(sha256) and is_plain(file)):
            return None
        return cls(recording, sha256, file)


@dataclass(slots=True)
class CollectedRecording:
    """What a store holds of one recording: each object with its size in bytes."""

    objects: dict[ObjectName, int] = field(default_factory=dict)

    @property
    def manifest(self) -> ObjectName | None:
        """The newest manifest; None while not all of a first copy is there."""
        manifests = [each for each in self.objects if each.manifest_number]
        return max(manifests, key=lambda each: (each.manifest_number, each.sha256), default=None)


def manifest_name(recording: str, sha256: str, number: int) -> ObjectName:
    """Return the name of a manifest; `number` counts those of its recording from 1."""
    return ObjectName(recording, sha256, f"manifest-{number:06}.json")


def is_plain(path: str) -> bool:
    """Return whether a relative path consists of letters, digits and ``_ . + = @ -`` only."""
    return all(_NAME.fullmatch(part) for part in path.split("/"))


def collected_recordings(listing: Iterable[StoredObject]) -> dict[str, CollectedRecording]:
    """Return the recordings of a store by name; other objects are left out."""
    found: dict[str, CollectedRecording] = {}
    for each in listing:
        if (name := ObjectName.parse(each.key)) is not None:
            found.setdefault(name.recording, CollectedRecording()).objects[name] = each.size_bytes
    return found
