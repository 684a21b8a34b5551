"""The catalogue of the recordings below a URL: their indexes are copied once, to a cache.

A recording without a valid index is indexed by reading ranges of it, and its index is put beside it
if the store lets this user.
"""

from __future__ import annotations

import hashlib
import os
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from robotctl.errors import RobotctlError
from robotctl.fleet.catalogue import Catalogue
from robotctl.fleet.catalogue_file import write_catalogue
from robotctl.fleet.database import database, parquet
from robotctl.fleet.history import rows_of
from robotctl.fleet.index_file import LAYOUT, write_index
from robotctl.fleet.indexing import NOT_CHECKED, Failures
from robotctl.fleet.jobs import Done, local_processes, results_of
from robotctl.fleet.stamps import stamps_of_each
from robotctl.paths import make_private
from robotctl.printable import printable
from robotctl.recording.disk.replaced_file import replaced_file
from robotctl.recording.format.derived_files import INDEX_FILE
from robotctl.rerun.check import check_recording
from robotctl.store import NoSuchObject, StoreError, open_store
from robotctl.store.store_path import StorePath

MAX_INDEX_BYTES: Final = 64 << 20

_AHEAD: Final = 16
"""Indexes that are asked for at once."""

CACHE_VARIABLE: Final = "XDG_CACHE_HOME"


@dataclass(frozen=True, slots=True)
class StoredRecording:
    """A recording below a URL, with the place of its index in the cache."""

    path: StorePath
    files: int
    size_bytes: int
    cached: Path

    @property
    def index(self) -> StorePath:
        """Where its index is in the store, if it has one."""
        return self.path / INDEX_FILE


@contextmanager
def stored_catalogue(
    place: StorePath, on_progress: Done = lambda done, total: None
) -> Iterator[Catalogue]:
    """Yield the catalogue of the recordings in the folders below a URL.

    Raises:
        NoSuchObject: There are none.
        StoreError: The store cannot be listed.
        UsageError: duckdb or obstore is not installed.
    """
    cache = make_private(_cache_folder() / _digest(str(place)))
    recordings = list(_recordings(place, cache))
    if not recordings:
        raise NoSuchObject(f"there is no recording in a folder below {place}", "check the URL")
    _copy_indexes([each for each in recordings if not each.cached.exists()], on_progress)
    old: dict[Path, StoredRecording] = {
        each.path: each for each in recordings if not each.cached.exists()
    }
    failures = _indexed(old, on_progress)
    present = [each for each in recordings if each.path not in failures]
    indexes = tuple(each.cached for each in present)
    path = cache / f"catalogue-{_digest(*(each.name for each in indexes))}.parquet"
    if not path.exists():
        _remove_all_but(cache, indexes)
        write_catalogue([path], None, (), indexes)
    left_out = (f"{printable(each.name)} is left out: {said}" for each, said in failures.items())
    yield Catalogue(path, indexes, tuple(left_out), failures)


def _cache_folder() -> Path:
    base = os.environ.get(CACHE_VARIABLE) or Path.home() / ".cache"
    return Path(base, "robotctl", "indexes")


def _recordings(place: StorePath, cache: Path) -> Iterator[StoredRecording]:
    """Yield the recordings that are folders below a URL."""
    files: dict[StorePath, list[StorePath]] = {}
    for file in place.glob("*/*.mcap"):
        files.setdefault(place / file.parent.name, []).append(file)
    for path in sorted(files):
        found = [each.described() for each in files[path]]
        state = sorted((each.key, each.size_bytes, each.etag) for each in found)
        name = f"{LAYOUT}-{_digest(path.name, *map(repr, state))}.parquet"
        yield StoredRecording(
            path, len(found), sum(each.size_bytes for each in found), cache / name
        )


def _copy_indexes(recordings: Sequence[StoredRecording], on_progress: Done) -> None:
    """Copy to the cache what the store has of their indexes, if it is of their present files."""
    waiting = deque(each for each in recordings if _has_index(each))
    total, asked = len(waiting), deque[StoredRecording]()
    copied: list[StoredRecording] = []
    while waiting or asked:
        while waiting and len(asked) < _AHEAD:
            each = waiting.popleft()
            each.index.reader().expect([(0, each.index.described().size_bytes)])
            asked.append(each)
        each = asked.popleft()
        with suppress(StoreError):  # then it is made again
            data = each.index.reader().read(0, MAX_INDEX_BYTES)
            with replaced_file(each.cached) as stream:
                stream.write(data)
            copied.append(each)
        on_progress(total - len(waiting) - len(asked), total)
    _remove_wrong(copied)


def _has_index(recording: StoredRecording) -> bool:
    return recording.index.is_file() and (recording.index.described().size_bytes <= MAX_INDEX_BYTES)


def _remove_wrong(copied: Sequence[StoredRecording]) -> None:
    """Remove those indexes that are not well formed, or not of the recording's present files."""
    stamps = stamps_of_each([each.cached for each in copied])
    good = [
        each for each, found in zip(copied, stamps, strict=True) if set(found) == {each.path.name}
    ]
    right: set[str] = set()
    if good:
        paths = [each.cached for each in good]
        of = {str(each.cached): (each.files, each.size_bytes) for each in good}
        with database(paths) as connection:
            rows = connection.execute(
                f"SELECT filename, files, size_bytes FROM {parquet(paths, ', filename = true')} "
                "WHERE kind = 'recording' AND \"check\" <> ?",
                [NOT_CHECKED],
            ).fetchall()
        right = {name for name, files, size in rows if of[name] == (files, size)}
    for each in copied:
        if str(each.cached) not in right:
            each.cached.unlink()


def _indexed(old: dict[Path, StoredRecording], on_progress: Done) -> Failures:
    """Index recordings, a process per processor, and return those that failed."""
    if not old:
        return {}
    job = _IndexJob({path: each.cached for path, each in old.items()})
    results = results_of(job, list(old), local_processes, on_progress)
    return {
        path: "the process that indexed it was killed" if said is None else said
        for path, said in results
        if said != ""
    }


@dataclass(frozen=True, slots=True)
class _IndexJob:
    """Indexes one recording in another process, and returns why that failed, or ""."""

    cached: dict[Path, Path]

    def __call__(self, recording: Path) -> str:
        try:
            report = check_recording(recording)
            says = [each.text for each in report.violations] + report.missing
            rows = rows_of(recording, report.verdict.value, says[0] if says else None, NOT_CHECKED)
            target = self.cached[recording]
            write_index(target, recording.name, rows, target.stem)
            assert isinstance(recording, StorePath)
            with suppress(StoreError):  # it may only be read
                _put_beside(recording, target.read_bytes())
        except (RobotctlError, OSError) as error:
            return str(error)
        return ""


def _put_beside(recording: StorePath, index: bytes) -> None:
    """Put an index beside the files; below its hash where theirs are, as `robotctl sync` does."""
    file = next(recording.glob("*.mcap"))
    folder, _, _ = file.described().key.rpartition("/")
    if folder.rpartition("/")[2] != recording.name:
        folder = f"{folder.rpartition('/')[0]}/{hashlib.sha256(index).hexdigest()}"
    open_store(recording.store_root).put(f"{folder}/{INDEX_FILE}", [index])


def _remove_all_but(cache: Path, indexes: Sequence[Path]) -> None:
    """Remove what the cache holds of recordings that have changed or are gone."""
    present = {each.name for each in indexes}
    for each in cache.iterdir():
        if each.name not in present:
            with suppress(OSError):
                each.unlink()


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode(errors="surrogateescape")).hexdigest()[:32]
