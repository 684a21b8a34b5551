"""The catalogue of a folder: the indexes of all its recordings in one file, without the samples.

Opening 10,000 small files takes seconds; the catalogue is read at once, and holds what it was made
from: only what has changed since then is read again.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from robotctl.errors import Refused
from robotctl.fleet.database import database, text
from robotctl.fleet.index_file import index_path, stamp_of, table_columns
from robotctl.fleet.indexing import Failures, index_recordings
from robotctl.recording.disk.access import protect_like
from robotctl.recording.disk.storage import is_being_written
from robotctl.recording.format.derived_files import INDEX_FILE

CATALOGUE_NAME: Final = INDEX_FILE


@dataclass(frozen=True, slots=True)
class Catalogue:
    """A catalogue that is up to date: its file, and the index of each recording in it.

    `live` are the recordings that are being made, `failures` those that cannot be indexed, each
    with the reason: both are missing in it.
    """

    path: Path
    indexes: tuple[Path, ...]
    live: tuple[Path, ...]
    failures: Failures

    def left_out(self) -> list[str]:
        """Return a sentence for each recording that is missing."""
        return [
            *(f"{path.name} is left out: it is being recorded" for path in self.live),
            *(f"{path.name} is left out: {said}" for path, said in self.failures.items()),
        ]


@contextmanager
def catalogue_of(
    folder: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Iterator[Catalogue]:
    """Index what has changed in a folder, and yield its catalogue.

    Where the folder cannot be written, the catalogue is a file that exists for the block only.

    Raises:
        OSError: The folder cannot be listed.
        Refused: duckdb is not installed, or an index cannot be written.
    """
    stamps = _stamps(folder)
    path = folder / CATALOGUE_NAME
    known = _stamps_in(path)
    changed = [each for each, stamp in stamps.items() if known.get(each.name) != stamp]
    live, old = _live_and_old(changed, stamps)
    failures: Failures = {}
    if old:
        failures = index_recordings(old, on_progress)
    missing = {*live, *failures}
    fresh = [each for each in changed if each not in missing]
    indexes = tuple(index_path(each) for each in stamps if each not in missing)
    gone = known.keys() - {each.name for each in stamps}
    if not (fresh or gone or missing & known.keys()) and known:
        yield Catalogue(path, indexes, tuple(live), failures)
        return
    kept = [each.name for each in stamps if each not in missing and each not in fresh]
    with tempfile.TemporaryDirectory(prefix="robotctl-catalogue-") as elsewhere:
        if os.access(folder, os.W_OK):
            with tempfile.TemporaryDirectory(prefix=".index-", dir=folder) as beside:
                made = Path(beside, CATALOGUE_NAME)
                _write(made, path if kept else None, kept, [index_path(each) for each in fresh])
                protect_like(made, folder)
                made.replace(path)
        else:
            made = Path(elsewhere, CATALOGUE_NAME)
            _write(made, path if kept else None, kept, [index_path(each) for each in fresh])
            path = made
        yield Catalogue(path, indexes, tuple(live), failures)


def _stamps(folder: Path) -> dict[Path, str]:
    """Return the stamp of each recording directly below a folder; links are not followed."""
    stamps = {}
    with os.scandir(folder) as entries:
        for each in sorted(entries, key=lambda entry: entry.name):
            is_file = each.name.endswith(".mcap") and each.is_file(follow_symlinks=False)
            is_folder = not each.name.startswith(".") and each.is_dir(follow_symlinks=False)
            if is_file or is_folder:
                try:
                    stamp = stamp_of(Path(each.path))
                except OSError:  # removed meanwhile, or of another user
                    continue
                if stamp:
                    stamps[Path(each.path)] = stamp
    return stamps


def _stamps_in(path: Path) -> dict[str, str]:
    """Return the stamps of the recordings in an index or a catalogue; none of one that is wrong."""
    if not path.is_file() or path.is_symlink():
        return {}
    with database(readable=[path]) as connection:
        import duckdb

        source = f"read_parquet({text(path)})"
        try:
            described = connection.execute(f"DESCRIBE SELECT * FROM {source}").fetchall()
            if {row[0]: row[1] for row in described} != table_columns():
                return {}
            found = connection.execute(
                f"SELECT recording, stamp FROM {source} WHERE kind = 'recording'"
            ).fetchall()
        except duckdb.Error:
            return {}
    return {str(name): str(stamp) for name, stamp in found}


def _live_and_old(
    changed: Sequence[Path], stamps: dict[Path, str]
) -> tuple[list[Path], list[Path]]:
    """Return the recordings that are being made, and those whose index is old or missing."""
    live: list[Path] = []
    old: list[Path] = []
    for recording in changed:
        if _stamps_in(index_path(recording)) == {recording.name: stamps[recording]}:
            continue
        (live if _is_live(recording) else old).append(recording)
    return live, old


def _is_live(recording: Path) -> bool:
    files = [recording] if recording.suffix == ".mcap" else recording.glob("*.mcap")
    try:
        return any(is_being_written(each) for each in files)
    except OSError:
        return False


def _write(
    target: Path, before: Path | None, kept: Collection[str], indexes: Sequence[Path]
) -> None:
    """Write a catalogue: of the one before, the recordings `kept`, and the indexes."""
    parts = []
    if before is not None:
        names = ", ".join(map(text, kept))
        parts.append(f"SELECT * FROM read_parquet({text(before)}) WHERE recording IN ({names})")
    if indexes:
        listed = ", ".join(map(text, indexes))
        parts.append(f"SELECT * FROM read_parquet([{listed}]) WHERE kind <> 'sample'")
    if not parts:
        columns = ", ".join(f'NULL::{kind} AS "{key}"' for key, kind in table_columns().items())
        parts.append(f"SELECT {columns} WHERE false")
    readable = [*indexes, *([] if before is None else [before])]
    with database(readable, target.parent) as connection:
        import duckdb

        try:
            connection.execute(
                f"COPY ({' UNION ALL '.join(parts)}) TO {text(target)} "
                "(FORMAT parquet, COMPRESSION zstd)"
            )
        except duckdb.Error as error:
            raise Refused(f"cannot write {target.parent.parent / target.name}: {error}") from error
