"""The catalogue of a folder: the indexes of all its recordings in one file, without the samples."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from robotctl.base.errors import Refused
from robotctl.base.files import open_regular
from robotctl.base.text import printable
from robotctl.collection.index_file import (
    closed_files,
    database,
    file_of,
    files_of,
    index_path,
    index_path_text,
    parquet,
    patterns,
    stamp_of,
    table_columns,
    text,
    write_parquet,
)
from robotctl.recording.format.names import INDEX_FILE

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

    from robotctl.base.pool import Done


Failures = dict[Path, str]
"""Recordings that could not be indexed, each with the reason."""


def index_recordings(
    recordings: Sequence[Path], on_progress: Done = lambda done, total: None
) -> Failures:
    """Index recordings in one process per CPU, and return the failures."""
    # Imported here: a question about indexed recordings needs neither processes nor the kernel.
    from robotctl.base.pool import local_processes, results_of
    from robotctl.collection.indexing import index_recording

    results = results_of(index_recording, recordings, local_processes, on_progress)
    return {
        path: "the process that indexed it was killed" if said is None else said
        for path, said in results
        if said != ""
    }


MAX_ROWS: Final = 10_000_000
"""Limit on a file's rows other than samples."""

Stamps = dict[str, str]
"""The stamp of each recording (see `stamp_of`), by the recording's name."""

_TYPES_IN_FILES: Final = {
    "VARCHAR": "BYTE_ARRAY UTF8",
    "BIGINT": "INT64 INT_64",
    "DOUBLE": "DOUBLE ",
    "FLOAT": "FLOAT ",
    "BOOLEAN": "BOOLEAN ",
}
"""SQL type -> physical and converted type in Parquet."""


def stamps_in(path: Path | str) -> Stamps:
    """Return {recording name: stamp} of one index or catalogue, {} if the file is unusable."""
    return stamps_of_each([path])[0]


def stamps_of_each(paths: Sequence[Path | str]) -> list[Stamps]:
    """Return {recording name: stamp} of each index or catalogue; see `stamp_of`.

    The result is {} for a link, an unreadable file, other columns, or more than MAX_ROWS rows.

    Raises:
        UsageError: duckdb is not installed.
    """
    present = [
        str(each)
        for each in paths
        if isinstance(each, str) or (each.is_file() and not each.is_symlink())
    ]
    found: dict[str, Stamps] = {}
    if present:
        with database(present) as connection:
            _collect(connection, present, found)
    return [found.get(str(each), {}) for each in paths]


def _collect(
    connection: DuckDBPyConnection, paths: Sequence[str], found: dict[str, Stamps]
) -> None:
    """Add the stamps in all readable files to `found`."""
    import duckdb

    if not paths:  # one query for all files: a query per file takes far longer
        return
    try:
        good = _well_formed(connection, paths)
        rows = _verified_stamps(connection, good) if good else []
    except duckdb.Error:
        middle = len(paths) // 2
        for half in (paths[:middle], paths[middle:]) if middle else ():
            _collect(connection, half, found)
        return
    for path, recording, stamp in rows:
        found.setdefault(path, {})[str(recording)] = str(stamp)


def _well_formed(connection: DuckDBPyConnection, paths: Sequence[str]) -> list[str]:
    """Return the files whose columns are those of an index."""
    columns = {f"{name} {_TYPES_IN_FILES[kind]}" for name, kind in table_columns().items()}
    known = ", ".join(map(text, columns))
    column = "name || ' ' || type || ' ' || coalesce(converted_type, '')"
    found = connection.execute(
        f"SELECT file_name FROM parquet_schema([{patterns(paths)}]) "
        f"WHERE num_children IS NULL GROUP BY file_name HAVING count(*) = {len(columns)} "
        f"AND count(DISTINCT {column}) FILTER ({column} IN ({known})) = {len(columns)}"
    )
    return [path for (path,) in found.fetchall()]


def _verified_stamps(
    connection: DuckDBPyConnection, paths: Sequence[str]
) -> list[tuple[str, object, object]]:
    """Return file, recording and stamp of each 'recording' row; skip files over `MAX_ROWS`."""
    source = parquet(paths, ", filename = true")
    counted = connection.execute(
        f"SELECT filename, count(*) FROM {source} WHERE kind <> 'sample' GROUP BY filename"
    ).fetchall()
    if any(count > MAX_ROWS for _, count in counted):
        small = [path for path, count in counted if count <= MAX_ROWS]
        return _verified_stamps(connection, small) if small else []
    return connection.execute(
        f"SELECT filename, recording, stamp FROM {source} WHERE kind = 'recording'"
    ).fetchall()


def write_catalogue(
    targets: Iterable[Path], before: str | None, kept: Collection[str], indexes: Sequence[Path]
) -> Path:
    """Write a catalogue to the first writable path in `targets`, and return this path.

    The catalogue has the rows of `indexes` without samples, and the rows of the recordings `kept`
    from the older catalogue `before`.

    Raises:
        Refused: None of the targets can be written.
    """
    parts = []
    if before is not None:
        names = ", ".join(map(text, kept))
        parts.append(f"SELECT * FROM {parquet([before])} WHERE recording IN ({names})")
    if indexes:
        parts.append(f"SELECT * FROM {parquet(indexes)} WHERE kind <> 'sample'")
    if not parts:
        columns = ", ".join(f'NULL::{kind} AS "{key}"' for key, kind in table_columns().items())
        parts.append(f"SELECT {columns} WHERE false")
    sources: list[Path | str] = [*indexes, *([] if before is None else [before])]
    failure = ""
    for target in targets:
        try:
            write_parquet(target, " UNION ALL ".join(parts), sources)
        except OSError as error:
            failure = f"cannot write {target}: {error.strerror or error}"
        else:
            return target
    raise Refused(failure)


CATALOGUE_NAME: Final = INDEX_FILE

GOING_ON: Final = "it is being recorded"
NOT_TEXT: Final = "its name is no UTF-8"
NOT_ALLOWED: Final = "this user may not read it"


@dataclass(frozen=True, slots=True)
class Catalogue:
    """The up-to-date catalogue of a folder: one file with the rows of its recordings' indexes.

    `left_out` has a sentence for each recording that is not completely in the catalogue.
    """

    path: Path
    indexes: tuple[str, ...]
    left_out: tuple[str, ...]
    failures: Failures


@contextmanager
def catalogue_of(
    folder: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Iterator[Catalogue]:
    """Index the changed recordings of a folder, and yield the folder's catalogue.

    The catalogue of a folder that cannot be written exists only during the block.

    Raises:
        OSError: The folder cannot be listed.
        Refused: Not even a temporary file can be written, or the folder's path is not UTF-8.
        UsageError: duckdb is not installed.
    """
    path = folder / CATALOGUE_NAME
    if not _is_text(str(path)):
        raise Refused(f"{printable(folder)}: {NOT_TEXT}", "give the folder another name")
    with ExitStack() as stack:
        before = _opened(path, stack)
        known = stamps_in(before) if before else {}
        stamps, left_out = _stamps(folder, known)
        changed = [folder / name for name, stamp in stamps.items() if known.get(name) != stamp]
        indexed = stamps_of_each(list(map(index_path, changed)))
        old = [
            each
            for each, found in zip(changed, indexed, strict=True)
            if found != {each.name: stamps[each.name]}
        ]
        failures = index_recordings(old, on_progress) if old else {}
        for each in changed:
            if each not in failures and not index_path(each).exists():
                failures[each] = "it was removed meanwhile"
        left_out += [_left_out(each.name, said) for each, said in failures.items()]
        fresh = [index_path(each) for each in changed if each not in failures]
        failed = {each.name for each in failures}
        kept = [name for name, stamp in stamps.items() if known.get(name) == stamp]
        indexes = tuple(
            index_path_text(f"{folder}/{name}") for name in stamps if name not in failed
        )
        if fresh or len(kept) < len(known) or not before:
            elsewhere = Path(stack.enter_context(tempfile.TemporaryDirectory()), CATALOGUE_NAME)
            path = write_catalogue((path, elsewhere), before if kept else None, kept, fresh)
        yield Catalogue(path, indexes, tuple(left_out), failures)


def _is_text(path: str) -> bool:
    try:
        path.encode()
    except UnicodeEncodeError:
        return False
    return True


def _opened(path: Path, stack: ExitStack) -> str | None:
    """Return a path of the catalogue that stays valid if the file is replaced, None on failure."""
    try:
        return None if path.is_symlink() else file_of(stack.enter_context(open_regular(path)))
    except OSError:
        return None


def _stamps(folder: Path, known: Stamps) -> tuple[Stamps, list[str]]:
    """Return the stamp of each recording directly in a folder, and sentences on those left out."""
    stamps: Stamps = {}
    left_out = []
    with os.scandir(folder) as entries:
        found = sorted((each.name, each.path) for each in entries if _may_be_recording(each))
    for name, path in found:
        if not _is_text(name):
            left_out.append(_left_out(name, NOT_TEXT))
            continue
        try:
            files = files_of(path)
            if not files:
                continue
            stamps[name] = stamp_of(files)
            if known.get(name) == stamps[name]:  # so all its files are closed
                continue
            closed = closed_files(files)
        except PermissionError:
            stamps.pop(name, None)
            left_out.append(_left_out(name, NOT_ALLOWED))
        except OSError:  # it was removed meanwhile
            stamps.pop(name, None)
        else:
            if not closed:
                del stamps[name]
                left_out.append(_left_out(name, GOING_ON))
            elif len(closed) < len(files):
                stamps[name] = stamp_of(closed)
                left_out.append(f"the last file of {_left_out(name, GOING_ON)}")
    return stamps, left_out


def _may_be_recording(entry: os.DirEntry[str]) -> bool:
    if entry.name.endswith(".mcap") and entry.is_file(follow_symlinks=False):
        return True
    return not entry.name.startswith(".") and entry.is_dir(follow_symlinks=False)


def _left_out(name: str, reason: str) -> str:
    return f"{printable(name)} is left out: {reason}"
