"""The manifest of a collected recording: its files. It is written last, when all of them exist."""

from __future__ import annotations

import hashlib
from typing import Annotated, Final, Self

import msgspec
from msgspec import Meta, Struct

from robotctl.collect.object_names import ObjectName, is_plain, manifest_name
from robotctl.errors import UnreadableFile

MAX_MANIFEST_BYTES: Final = 16 << 20
"""Room for 60,000 files."""

_DATA_SUFFIX: Final = ".mcap"


class CollectedFile(Struct, frozen=True):
    """A file of a recording; `modified_ns` since the epoch."""

    name: str
    size_bytes: Annotated[int, Meta(ge=0)]
    sha256: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    modified_ns: int


class Manifest(Struct, frozen=True):
    """The files of a recording, in the order of their names."""

    recording: str
    files: tuple[CollectedFile, ...]

    def to_bytes(self) -> bytes:
        """Return it as JSON: the same files give the same bytes."""
        return msgspec.json.encode(self) + b"\n"

    @classmethod
    def from_bytes(cls, text: bytes) -> Self:
        """Return the manifest in a text of `to_bytes`, also of a later version.

        Raises:
            UnreadableFile: It is none.
        """
        try:
            found = msgspec.json.decode(text, type=cls)
        except (msgspec.DecodeError, RecursionError) as error:
            raise UnreadableFile(f"not a manifest: {error}") from error
        if not all(is_plain(file.name) for file in found.files):
            raise UnreadableFile("not a manifest: it holds a name that is no file's")
        return found

    def object_of(self, file: CollectedFile) -> ObjectName:
        """Return the object that holds a file of it."""
        return ObjectName(self.recording, file.sha256, file.name)

    def name(self, number: int) -> ObjectName:
        """Return the object that holds the manifest itself."""
        return manifest_name(self.recording, hashlib.sha256(self.to_bytes()).hexdigest(), number)

    def data(self) -> Manifest:
        """Return it without what was made from the data."""
        data = (file for file in self.files if file.name.endswith(_DATA_SUFFIX))
        return Manifest(self.recording, tuple(data))

    def lost_data(self, here: Manifest) -> bool:
        """Return whether it names recorded data that `here` has no more, as after retention."""
        names = {file.name for file in here.files}
        return any(file.name not in names for file in self.data().files)

    def united(self, here: Manifest) -> Manifest:
        """Return the manifest with the files of `here`, and those that only this one names."""
        files = {file.name: file for file in (*self.files, *here.files)}
        return Manifest(self.recording, tuple(files[name] for name in sorted(files)))
