"""Copies recordings between folders and buckets; removes local files whose copies were read back.

A copy has the path RECORDING/FILE, an older copy RECORDING/SHA256/FILE. A file counts as copied if
the store has an object of its name and size.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from robotctl.base.errors import RobotctlError, UnreadableFile
from robotctl.base.store.objects import ObjectStore, Stamp, StoredObject, StoreError, without_hashes
from robotctl.base.text import printable
from robotctl.collection.sources import (
    REPLACED,
    STORED_PIECE_BYTES,
    SUFFIX,
    LocalFile,
    OfferedRecording,
    Pace,
    StoredFile,
    WrongContent,
    open_regular_file,
    recording_of,
)
from robotctl.recording.format.disk import reason_of
from robotctl.recording.keep.listing import CLIPS_FOLDER, CatalogFile, CatalogFolder
from robotctl.recording.keep.retention import (
    RetentionPolicy,
    enforce_retention,
    note_removal,
    withdraw_note,
)

GIVE_UP_AFTER: Final = 3
"""Number of recordings in a row for which the store may fail until the run ends."""

Stored = dict[str, list[StoredObject]]
"""The objects of a store by their paths in a copy."""


@dataclass(frozen=True, slots=True)
class CopiedFile:
    """A file that was copied or, in a dry run, would be copied."""

    recording: str
    name: str
    size_bytes: int
    sha256: str


@dataclass(slots=True)
class Synced:
    """The files that a run copied, and sentences about other files."""

    complete: list[str] = field(default_factory=list)
    """Recordings that the store has completely."""

    copied: list[CopiedFile] = field(default_factory=list)
    live: list[str] = field(default_factory=list)
    """Recordings that are still being made, of which only finished files are copied."""

    problems: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """A sentence for each file whose object in the store does not have the same content."""

    @property
    def copied_bytes(self) -> int:
        """The total size of the files in `copied`."""
        return sum(file.size_bytes for file in self.copied)


@dataclass(slots=True)
class Pruned:
    """The removed files, and a sentence for each file that had to be kept."""

    removed: list[CatalogFile] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)


def copy_recordings(
    recordings: Sequence[OfferedRecording],
    store: ObjectStore,
    *,
    pace: Pace = lambda count: None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    dry_run: bool = False,
) -> Synced:
    """Copy the files that the store lacks; each failure adds a sentence to the result.

    `on_progress` gets the bytes handled and the total. GIVE_UP_AFTER failures in a row end the run.

    Raises:
        StoreError: The store cannot be listed.
    """
    run, there = Synced(), _stored(store)
    total, done, failed = sum(each.size_bytes for each in recordings), 0, 0
    for each in recordings:

        def send(count: int) -> None:
            pace(count)
            nonlocal done
            done = min(done + count, total)
            on_progress(done, total)

        begun, copy = done, _Copy(each, there, store, send, dry_run=dry_run)
        try:
            copy.make()
            failed = 0
        except StoreError as error:
            copy.problems.append(str(error))
            failed += 1
        _add(run, each, copy)
        if failed == GIVE_UP_AFTER:
            run.problems.append(f"{store.name} fails too often: the rest is left for later")
            break
        done = begun + each.size_bytes
        on_progress(done, total)
    return run


def _add(run: Synced, recording: OfferedRecording, copy: _Copy) -> None:
    name = printable(recording.name)
    run.problems += (f"{name}: {said}" for said in copy.problems)
    run.wrong += copy.wrong
    run.copied += copy.sent
    if recording.live:
        run.live.append(recording.name)
    elif not (copy.problems or copy.wrong or (copy.dry_run and copy.sent)):
        run.complete.append(recording.name)


class _Copy:
    """Copies one recording."""

    def __init__(
        self,
        recording: OfferedRecording,
        there: Stored,
        store: ObjectStore,
        pace: Pace,
        *,
        dry_run: bool,
    ) -> None:
        self._recording = recording
        self._there = there
        self._store = store
        self._pace = pace
        self.dry_run = dry_run
        self.sent: list[CopiedFile] = []
        self.problems = list(recording.left_out)
        self.wrong: list[str] = []

    def make(self) -> None:
        """Copy the data files, then the files that were generated from the data."""
        files = self._recording.files
        for file in (each for each in files if not _is_replaced(each.key)):
            found = self._there.get(file.key, [])
            if not found:
                self._send(file)
            elif all(each.size_bytes != file.size_bytes for each in found):
                self.wrong.append(str(_wrong_content(self._store, found[0].key)))
        if self.wrong or len(self.problems) > len(self._recording.left_out):
            return  # metadata that lists the files must not be stored before them
        for file in (each for each in files if _is_replaced(each.key)):
            found = self._there.get(file.key, [])
            if not (_has_as_new(found, file) or (found and self._more_is_there())):
                self._send(file)

    def _more_is_there(self) -> bool:
        """Return whether the store has data files of the recording that are gone here."""
        here = {file.key for file in self._recording.files}
        return any(
            recording_of(key) == self._recording.name and key.endswith(SUFFIX) and key not in here
            for key in self._there
        )

    def _send(self, file: LocalFile | StoredFile) -> None:
        try:
            if isinstance(file, StoredFile):
                file = file.with_stamp()
            sha256 = file.sha256(self._pace)
            if not self.dry_run:
                self._put(file, Stamp(sha256, file.modified_ns))
        except StoreError:
            raise
        except WrongContent as error:
            self.wrong.append(str(error))
        except UnreadableFile as error:
            self.problems.append(str(error))
        else:
            name = file.key.rpartition("/")[2]
            if f"/{CLIPS_FOLDER}/" in file.key:
                name = f"{CLIPS_FOLDER}/{name}"
            self.sent.append(CopiedFile(self._recording.name, name, file.size_bytes, sha256))

    def _put(self, file: LocalFile | StoredFile, stamp: Stamp) -> None:
        def content() -> Iterator[bytes]:
            for piece in file.content(stamp.sha256):
                self._pace(len(piece))
                yield piece

        if _is_replaced(file.key):
            self._store.put(file.key, content(), stamp)
            return
        is_new = self._store.put_if_absent(file.key, content(), stamp)
        if not (is_new or self._store.head(file.key).size_bytes == file.size_bytes):
            raise _wrong_content(self._store, file.key)


def _stored(store: ObjectStore, prefix: str = "") -> Stored:
    found: Stored = {}
    for each in store.list(prefix):
        found.setdefault(without_hashes(each.key), []).append(each)
    return found


def _is_replaced(key: str) -> bool:
    return key.rpartition("/")[2] in REPLACED


def _has_as_new(there: Sequence[StoredObject], here: LocalFile | StoredFile) -> bool:
    """Return whether one of the objects has the size of the file and is not older."""
    same = [each for each in there if each.size_bytes == here.size_bytes]
    # A store's listing has the time of storing; only `with_stamp` returns the time of writing.
    if isinstance(here, StoredFile) and any(each.modified_ns < here.modified_ns for each in same):
        here = here.with_stamp()
    return any(each.modified_ns >= here.modified_ns for each in same)


def _wrong_content(store: ObjectStore, key: str) -> WrongContent:
    return WrongContent(
        f"{store.name}/{key} has other content than the file here",
        "what is here stays; remove that one to copy it again",
    )


def prune(
    recordings: Path,
    store: ObjectStore,
    policy: RetentionPolicy,
    now_s: float,
    *,
    complete: Collection[str],
    pace: Pace = lambda count: None,
) -> Pruned:
    """Remove the files in the folder `recordings` that exceed `policy`, the oldest first.

    A file is removed only if its recording is in `complete`, and the store returns exactly the
    bytes of the file. `now_s` is in seconds since the epoch.

    Raises:
        OSError: The folder cannot be listed.
    """
    pruned = Pruned()
    there: dict[str, Stored] = {}
    failed = 0

    def is_stored(file: CatalogFile, folder: CatalogFolder) -> bool:
        nonlocal failed
        if failed == GIVE_UP_AFTER:
            return False
        name = folder.path.name
        try:
            if name not in complete:
                raise UnreadableFile("its recording is not completely in the store")
            if name not in there:
                there[name] = _stored(store, name)
            key = f"{name}/{file.path.relative_to(folder.path).as_posix()}"
            _read_back(store, key, there[name].get(key, []), file.path, pace)
            note_removal(recordings, file.path, f"removed after its copy to {store.name} was read")
        except WrongContent as error:
            pruned.wrong.append(str(error))
            failed = 0
        except OSError as error:
            cause = f"its removal cannot be noted: {reason_of(error)}"
            pruned.problems.append(f"{file.path.name} is kept: {cause}")
        except RobotctlError as error:
            pruned.problems.append(f"{file.path.name} is kept: {error}")
            failed = failed + 1 if isinstance(error, StoreError) else 0
        else:
            failed = 0
            return True
        return False

    def not_removed(file: CatalogFile, error: OSError) -> None:
        with suppress(OSError):
            withdraw_note(recordings, file.path)
        if not isinstance(error, FileNotFoundError):
            cause = f"it cannot be removed: {reason_of(error)}"
            pruned.problems.append(f"{file.path.name} is kept: {cause}")

    pruned.removed = enforce_retention(
        recordings, policy, now_s, may_remove=is_stored, on_failure=not_removed
    )
    return pruned


def _read_back(
    store: ObjectStore, key: str, found: Sequence[StoredObject], path: Path, pace: Pace
) -> None:
    """Raise an error unless one of the objects in the store has exactly the bytes of a file."""
    if not found:
        raise UnreadableFile("it is not in the store")
    if not any(_is_same(store, each, path, pace) for each in found):
        raise _wrong_content(store, found[0].key)


def _is_same(store: ObjectStore, found: StoredObject, path: Path, pace: Pace) -> bool:
    with open_regular_file(path) as file:
        if os.fstat(file.fileno()).st_size != found.size_bytes:
            return False
        for begin in range(0, found.size_bytes, STORED_PIECE_BYTES):
            end = min(begin + STORED_PIECE_BYTES, found.size_bytes)
            pace(end - begin)
            piece = store.get_range(found, begin, end)
            pace(0)
            if piece != os.pread(file.fileno(), end - begin, begin):
                return False
        return os.fstat(file.fileno()).st_size == found.size_bytes
