"""The catalogue of the recordings below a URL: their indexes are copied once, to a cache.

A recording without a valid index is indexed by reading ranges of it, and its index is put beside it
if the store lets this user.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fcntl import LOCK_EX, LOCK_NB, LOCK_SH, flock
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from robotctl.errors import Refused, RobotctlError
from robotctl.fleet.catalogue import Catalogue
from robotctl.fleet.catalogue_file import write_catalogue
from robotctl.fleet.database import database, parquet
from robotctl.fleet.history import rows_of
from robotctl.fleet.index_file import LAYOUT, index_path, write_index
from robotctl.fleet.indexing import Failures
from robotctl.fleet.jobs import Done, local_processes, results_of
from robotctl.fleet.recording_index import NOT_CHECKED
from robotctl.fleet.stamps import stamps_of_each
from robotctl.paths import make_private
from robotctl.printable import printable
from robotctl.recording.disk.atomic_output import replaced_file
from robotctl.regular_file import open_folder
from robotctl.rerun.check import check_recording
from robotctl.store import NoSuchObject, StoreError, open_store
from robotctl.store.hash_folders import is_hash
from robotctl.store.store_path import StorePath

MAX_INDEX_BYTES: Final = 64 << 20

_AHEAD: Final = 16
"""Indexes that are asked for at once."""

_INCOMING: Final = "incoming-"
"""The folder for indexes that are not looked at yet."""

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
        path = index_path(self.path)
        assert isinstance(path, StorePath)
        return path


@contextmanager
def stored_catalogue(
    place: StorePath, on_progress: Done = lambda done, total: None
) -> Iterator[Catalogue]:
    """Yield the catalogue of the recordings directly below a URL: folders, and single files.

    Several processes may do so at once.

    Raises:
        NoSuchObject: There are none.
        StoreError: The store cannot be listed.
        Refused: The cache cannot be written.
        UsageError: duckdb or obstore is not installed.
    """
    begun_s = time.time()
    cache = make_private(_cache_folder() / _digest(str(place)))
    with _in_use(cache):
        recordings = list(_recordings(place, cache))
        if not recordings:
            raise NoSuchObject(f"there is no recording below {place}", "check the URL")
        try:
            catalogue = _filled(cache, recordings, on_progress)
        except OSError as error:
            cause = f"cannot write {cache}: {error.strerror or error}"
            raise Refused(cause, f"free some space, or set {CACHE_VARIABLE}") from error
        yield catalogue
    _tidy(cache, {catalogue.path, *map(Path, catalogue.indexes)}, begun_s)


def _filled(cache: Path, recordings: Sequence[StoredRecording], on_progress: Done) -> Catalogue:
    """Return the catalogue after what the cache lacks was added to it."""
    _copy_indexes([each for each in recordings if not each.cached.exists()], cache, on_progress)
    old: dict[Path, StoredRecording] = {
        each.path: each for each in recordings if not each.cached.exists()
    }
    failures = _indexed(old, on_progress)
    present = [each for each in recordings if each.path not in failures]
    indexes = tuple(each.cached for each in present)
    path = cache / f"catalogue-{_digest(*(each.name for each in indexes))}.parquet"
    if not path.exists():
        write_catalogue([path], None, (), indexes)
    left_out = (f"{printable(each.name)} is left out: {said}" for each, said in failures.items())
    return Catalogue(path, tuple(map(str, indexes)), tuple(left_out), failures)


def _cache_folder() -> Path:
    base = os.environ.get(CACHE_VARIABLE) or Path.home() / ".cache"
    return Path(base, "robotctl", "indexes")


def _recordings(place: StorePath, cache: Path) -> Iterator[StoredRecording]:
    """Yield the recordings directly below a URL."""
    files: dict[StorePath, list[StorePath]] = {file: [file] for file in place.glob("*.mcap")}
    for file in place.glob("*/*.mcap"):
        files.setdefault(place / file.parent.name, []).append(file)
    for path in sorted(files):
        found = [each.described() for each in files[path]]
        state = sorted((each.key, each.size_bytes, each.etag) for each in found)
        name = f"{LAYOUT}-{_digest(path.name, *map(repr, state))}.parquet"
        yield StoredRecording(
            path, len(found), sum(each.size_bytes for each in found), cache / name
        )


def _copy_indexes(recordings: Sequence[StoredRecording], cache: Path, on_progress: Done) -> None:
    """Copy to the cache what the store has of their indexes, if it is of their present files."""
    waiting = deque(each for each in recordings if _has_index(each))
    total, asked = len(waiting), deque[StoredRecording]()
    copied: dict[Path, StoredRecording] = {}
    with TemporaryDirectory(prefix=_INCOMING, dir=cache) as incoming:
        while waiting or asked:
            while waiting and len(asked) < _AHEAD:
                each = waiting.popleft()
                each.index.reader().expect([(0, each.index.described().size_bytes)])
                asked.append(each)
            each = asked.popleft()
            with suppress(StoreError):  # then it is made again
                data = each.index.reader().read(0, MAX_INDEX_BYTES)
                path = Path(incoming, each.cached.name)
                with replaced_file(path) as stream:  # it is on the disk before it has its name
                    stream.write(data)
                copied[path] = each
            on_progress(total - len(waiting) - len(asked), total)
        for path in _right_ones(copied):
            path.replace(copied[path].cached)


def _has_index(recording: StoredRecording) -> bool:
    return recording.index.is_file() and (recording.index.described().size_bytes <= MAX_INDEX_BYTES)


def _right_ones(copied: Mapping[Path, StoredRecording]) -> Iterator[Path]:
    """Yield those indexes that are well formed, and of the present files of their recording."""
    stamps = stamps_of_each(list(copied))
    good = [
        path
        for path, found in zip(copied, stamps, strict=True)
        if set(found) == {copied[path].path.name}
    ]
    if not good:
        return
    with database(good) as connection:
        rows = connection.execute(
            f"SELECT filename, files, size_bytes FROM {parquet(good, ', filename = true')} "
            "WHERE kind = 'recording' AND \"check\" <> ?",
            [NOT_CHECKED],
        ).fetchall()
    for name, files, size_bytes in rows:
        recording = copied[Path(name)]
        if (files, size_bytes) == (recording.files, recording.size_bytes):
            yield Path(name)


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
    target = index_path(recording)
    file = recording if recording.is_file() else next(recording.glob("*.mcap"))
    folder, _, _ = file.described().key.rpartition("/")
    above, _, last = folder.rpartition("/")
    if is_hash(last):
        folder = f"{above}/{hashlib.sha256(index).hexdigest()}"
    key = f"{folder}/{target.name}".lstrip("/")
    open_store(recording.store_root).put(key, [index])


@contextmanager
def _in_use(cache: Path) -> Iterator[None]:
    """Keep other processes from removing what is in the cache."""
    with open_folder(cache) as descriptor:
        with suppress(OSError):  # a file system without locks
            flock(descriptor, LOCK_SH)
        yield


def _tidy(cache: Path, present: Collection[Path], begun_s: float) -> None:
    """Remove what was there before, and is of recordings that have changed or are gone.

    What another process uses stays: it, or the next one, removes it.
    """
    with suppress(OSError), open_folder(cache) as descriptor:
        flock(descriptor, LOCK_EX | LOCK_NB)
        for each in cache.iterdir():
            if each not in present and each.lstat().st_mtime < begun_s:
                if each.name.startswith(_INCOMING):
                    shutil.rmtree(each)
                else:
                    each.unlink()


def _digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode(errors="surrogateescape")).hexdigest()[:32]
