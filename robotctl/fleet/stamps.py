"""What indexes and catalogues were made from, and which of them are well formed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from robotctl.fleet.database import database, parquet, patterns, text
from robotctl.fleet.index_file import table_columns

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

MAX_ROWS: Final = 10_000_000
"""Rows beside samples, of all recordings of a catalogue: a month of a robot has some 100,000."""

Stamps = dict[str, str]
"""The stamp of each recording, by its name."""

_TYPES_IN_FILES: Final = {
    "VARCHAR": "BYTE_ARRAY UTF8",
    "BIGINT": "INT64 INT_64",
    "DOUBLE": "DOUBLE ",
    "FLOAT": "FLOAT ",
    "BOOLEAN": "BOOLEAN ",
}
"""Physical and converted type in Parquet."""


def stamps_in(path: Path | str) -> Stamps:
    """Return the stamps of the recordings in an index or a catalogue; none of one that is wrong.

    Raises:
        UsageError: duckdb is not installed.
    """
    return stamps_of_each([path])[0]


def stamps_of_each(paths: Sequence[Path | str]) -> list[Stamps]:
    """Return the stamps of the recordings in each file; none of a file that is wrong.

    A file is wrong if it cannot be read, is a link, has another layout, or over `MAX_ROWS` rows
    beside samples.

    Raises:
        UsageError: duckdb is not installed.
    """
    present = [str(each) for each in paths if isinstance(each, str) or _is_file(each)]
    found: dict[str, Stamps] = {}
    if present:
        with database(present) as connection:
            _collect(connection, present, found)
    return [found.get(str(each), {}) for each in paths]


def _is_file(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def _collect(
    connection: DuckDBPyConnection, paths: Sequence[str], found: dict[str, Stamps]
) -> None:
    """Add the stamps in these files, all at once: one after the other takes ten times as long.

    Unreadable files are found by bisection.
    """
    import duckdb

    if not paths:
        return
    try:
        good = _well_formed(connection, paths)
        rows = _stamps(connection, good) if good else []
    except duckdb.Error:
        middle = len(paths) // 2
        for half in (paths[:middle], paths[middle:]) if middle else ():
            _collect(connection, half, found)
        return
    for path, recording, stamp in rows:
        found.setdefault(path, {})[str(recording)] = str(stamp)


def _well_formed(connection: DuckDBPyConnection, paths: Sequence[str]) -> list[str]:
    """Return the files of the right layout."""
    columns = {f"{name} {_TYPES_IN_FILES[kind]}" for name, kind in table_columns().items()}
    known = ", ".join(map(text, columns))
    column = "name || ' ' || type || ' ' || coalesce(converted_type, '')"
    found = connection.execute(
        f"SELECT file_name FROM parquet_schema([{patterns(paths)}]) "
        f"WHERE num_children IS NULL GROUP BY file_name HAVING count(*) = {len(columns)} "
        f"AND count(DISTINCT {column}) FILTER ({column} IN ({known})) = {len(columns)}"
    )
    return [path for (path,) in found.fetchall()]


def _stamps(
    connection: DuckDBPyConnection, paths: Sequence[str]
) -> list[tuple[str, object, object]]:
    """Return file, recording and stamp of each row of a recording."""
    source = parquet(paths, ", filename = true")
    counted = connection.execute(
        f"SELECT filename, count(*) FROM {source} WHERE kind <> 'sample' GROUP BY filename"
    ).fetchall()
    if any(count > MAX_ROWS for _, count in counted):
        small = [path for path, count in counted if count <= MAX_ROWS]
        return _stamps(connection, small) if small else []
    return connection.execute(
        f"SELECT filename, recording, stamp FROM {source} WHERE kind = 'recording'"
    ).fetchall()
