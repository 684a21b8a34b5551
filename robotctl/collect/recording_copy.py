"""Copies what a store lacks of one recording, its manifest last."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from robotctl.collect.hash_ledger import FileChanged, HashLedger
from robotctl.collect.local_files import Pace, open_collected, pieces_of
from robotctl.collect.local_recordings import LocalRecording
from robotctl.collect.manifest import CollectedFile, Manifest
from robotctl.collect.missing_objects import missing_of
from robotctl.collect.object_names import CollectedRecording, ObjectName
from robotctl.collect.read_back import WrongContent, read_manifest, wrong_content
from robotctl.errors import UnreadableFile
from robotctl.store import PART_BYTES, ObjectStore, StoreError


class RecordingCopy:
    """The copy of a recording: what was sent, and a sentence for all that is not in the store."""

    def __init__(
        self,
        recording: LocalRecording,
        there: CollectedRecording,
        store: ObjectStore,
        ledger: HashLedger,
        pace: Pace,
    ) -> None:
        self._recording = recording
        self._there = there
        self._store = store
        self._ledger = ledger
        self._pace = pace
        self.sent: list[CollectedFile] = []
        """In a dry run: what would be sent."""

        self.problems = list(recording.left_out)
        self.wrong: list[str] = []
        """Objects that do not hold what their name says."""

    def make(self, *, dry_run: bool) -> None:
        """Copy what can be copied, and name the rest.

        Raises:
            StoreError: The store fails.
        """
        here = self._manifest()
        if not here.files:
            return
        try:
            self._copy(here, dry_run=dry_run)
        except StoreError:
            raise
        except WrongContent as error:
            self.wrong.append(str(error))
        except UnreadableFile as error:
            self.problems.append(str(error))

    def _manifest(self) -> Manifest:
        """Return the manifest of the files here that can be read."""
        files = []
        for name, path in sorted(self._recording.files.items()):
            try:
                stamp, sha256 = self._ledger.hash_of(path, self._pace)
            except UnreadableFile as error:
                self.problems.append(str(error))
            else:
                files.append(CollectedFile(name, stamp.size, sha256, stamp.modified_ns))
        return Manifest(self._recording.name, tuple(files))

    def _copy(self, here: Manifest, *, dry_run: bool) -> None:
        missing = missing_of(here, self._there, lambda: read_manifest(self._store, self._there))
        self.wrong += [str(wrong_content(self._store, here.object_of(x))) for x in missing.wrong]
        are_there = not missing.wrong
        for file in missing.files:
            try:
                if not dry_run:
                    self._send(here.object_of(file), file)
            except StoreError:
                raise
            except UnreadableFile as error:
                self.problems.append(str(error))
                are_there = False
            else:
                self.sent.append(file)
        if dry_run:
            return
        if missing.manifest is not None and are_there:
            name = missing.manifest.name(missing.number)
            self._store.put_if_absent(name.key, missing.manifest.to_bytes())
        for file in missing.lost:
            self.problems.append(f"{file.name} is neither here nor in the store any more")

    def _send(self, target: ObjectName, file: CollectedFile) -> None:
        path = self._recording.files[file.name]
        content = _verified(path, file.sha256, self._pace)
        try:
            if file.size_bytes <= PART_BYTES:
                self._store.put_if_absent(target.key, b"".join(content))
            else:  # what may be there has the same hash: to replace it changes nothing
                self._store.put(target.key, content)
        except FileChanged:
            self._ledger.forget(path)
            raise


def _verified(path: Path, sha256: str, pace: Pace) -> Iterator[bytes]:
    """Yield the content of a file whose hash is known.

    Raises:
        FileChanged: It has another content, as is known at its end.
        UnreadableFile: It cannot be read.
    """
    digest = hashlib.sha256()
    with open_collected(path) as file:
        for piece in pieces_of(file):
            pace(len(piece))
            digest.update(piece)
            yield piece
    if digest.hexdigest() != sha256:
        raise FileChanged(f"{path.name} was written while it was copied", "run it again")
