"""Copies the recordings of a folder to a store, each file under its hash."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from robotctl.collect.hash_ledger import FileChanged, HashLedger
from robotctl.collect.local_files import collected_paths, open_collected, pieces_of
from robotctl.collect.manifest import CollectedFile, Manifest
from robotctl.collect.missing_objects import missing_of
from robotctl.collect.object_names import CollectedRecording, collected_recordings, is_plain
from robotctl.collect.read_back import WrongContent, read_manifest, wrong_content
from robotctl.errors import RobotctlError, UnreadableFile
from robotctl.printable import printable
from robotctl.recording.keep.catalog import CatalogFolder, own_recordings
from robotctl.store import PART_BYTES, ObjectStore, StoreError

Pace = Callable[[int], None]
"""Called before this number of bytes is sent or read back; waits as long as a limit demands."""

GIVE_UP_AFTER: Final = 3
"""Recordings in a row whose copy the store fails: it is away, and so the rest is left for later."""


@dataclass(slots=True)
class Collected:
    """What a run did: objects that were copied, by recording, and sentences about the rest."""

    complete: list[str] = field(default_factory=list)
    """Recordings that the store has completely."""

    copied: dict[str, list[CollectedFile]] = field(default_factory=dict)
    live: list[str] = field(default_factory=list)
    """Recordings that are being made: the store has their finished files."""

    problems: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    """Objects that do not hold what their name says."""

    @property
    def copied_bytes(self) -> int:
        """Bytes of the files that were copied."""
        return sum(file.size_bytes for files in self.copied.values() for file in files)


def collect(
    recordings: Path,
    store: ObjectStore,
    ledger: HashLedger,
    *,
    pace: Pace = lambda count: None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    dry_run: bool = False,
) -> Collected:
    """Copy what the store lacks; `on_progress` gets bytes done and in total.

    A recording that cannot be copied is told in `problems`, and the next one is tried.

    Raises:
        OSError: The folder cannot be listed.
        StoreError: The store cannot be listed.
    """
    there = collected_recordings(store.list())
    found = [each for each in own_recordings(recordings) if collected_paths(each)]
    run = Collected()
    total, done, sent, failed = sum(map(_size, found)), 0, 0, 0

    def send(count: int) -> None:
        pace(count)
        nonlocal sent
        sent += count
        on_progress(min(done + sent, total), total)

    for each in found:
        on_progress(done, total)
        name, sent = each.path.name, 0
        try:
            lacking = _copy(each, there.get(name), store, ledger, send, dry_run=dry_run)
        except WrongContent as error:
            run.wrong.append(str(error))
        except RobotctlError as error:
            run.problems.append(f"{printable(name)}: {error}")
            failed = failed + 1 if isinstance(error, StoreError) else 0
            if failed == GIVE_UP_AFTER:
                run.problems.append(f"{store.name} fails too often: the rest is left for later")
                break
        else:
            failed = 0
            if lacking:
                run.copied[name] = lacking
            if each.live:
                run.live.append(name)
            elif not (lacking and dry_run):
                run.complete.append(name)
        done += _size(each)
    else:
        ledger.forget_the_rest()
    on_progress(total, total)
    return run


def manifest_of(recording: CatalogFolder, ledger: HashLedger) -> Manifest:
    """Return the manifest of the files that are here.

    Raises:
        UnreadableFile: One cannot be read, or was written meanwhile.
    """
    files = []
    for path in collected_paths(recording):
        stamp, sha256 = ledger.hash_of(path)
        name = path.relative_to(recording.path).as_posix()
        files.append(CollectedFile(name, stamp.size, sha256, stamp.modified_ns))
    return Manifest(recording.path.name, tuple(sorted(files, key=lambda each: each.name)))


def _copy(
    recording: CatalogFolder,
    there: CollectedRecording | None,
    store: ObjectStore,
    ledger: HashLedger,
    pace: Pace,
    *,
    dry_run: bool,
) -> list[CollectedFile]:
    """Copy what the store lacks of a recording, its manifest last; return the files.

    Raises:
        UnreadableFile: A file here cannot be read, was written meanwhile, or is lost.
        WrongContent: An object is not what its name says.
        RobotctlError: The store fails, or a name is none that it can hold.
    """
    here = manifest_of(recording, ledger)
    for name in (here.recording, *(file.name for file in here.files)):
        if not is_plain(name):
            cure = "rename it: letters, digits and _ . + = @ - only"
            raise UnreadableFile(f"{printable(name)} is left out", cure)
    stored = there or CollectedRecording()
    missing = missing_of(here, stored, lambda: read_manifest(store, stored))
    for file in missing.wrong:
        raise wrong_content(store, here.object_of(file))
    if dry_run:
        return list(missing.files)
    for file in missing.files:
        key, path = here.object_of(file).key, recording.path / file.name
        try:
            content = _verified(path, file.sha256, pace)
            if file.size_bytes <= PART_BYTES:
                store.put_if_absent(key, b"".join(content))
            else:  # what may be there has the same hash: to replace it changes nothing
                store.put(key, content)
        except FileChanged:
            ledger.forget(path)
            raise
    if missing.manifest is not None:
        key = missing.manifest.name(missing.number).key
        store.put_if_absent(key, missing.manifest.to_bytes())
    for file in missing.lost:
        raise UnreadableFile(f"{file.name} is neither here nor in the store any more")
    return list(missing.files)


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


def _size(recording: CatalogFolder) -> int:
    return sum(file.size for file in (*recording.files, *recording.clips) if not file.live)
