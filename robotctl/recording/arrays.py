"""Fields of a topic over time as NumPy arrays, and tables as Parquet files.

Parquet needs duckdb (the extra `parquet`).
"""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from robotctl.base.errors import RobotctlError, UnreadableFile, UsageError
from robotctl.messages.definition import NUMBERS
from robotctl.messages.fields import FieldPath, ValueKind, WrongValue, parse_path
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.reader import Recording
from robotctl.recording.table import TIME_COLUMNS, Row, TopicTable, choose_topic, json_of

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


Array = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True)
class TopicArrays:
    """The fields of a topic, one entry for each message, in the order of `log_ns`.

    `log_ns` and `publish_ns` are when a message was received and published [ns since the epoch],
    `time_s` is the log time since the first message of the recording [s]. `arrays["a.b"]` is a
    field: numbers have the field's type, an array of n numbers has n columns, and texts, bytes and
    sequences are objects.
    """

    topic: str
    type_name: str
    log_ns: Array
    publish_ns: Array
    time_s: Array
    fields: Mapping[str, Array]

    def __getitem__(self, path: str) -> Array:
        """Return the array of a field that was read."""
        return self.fields[path]

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.log_ns)


def read_arrays(
    path: Path,
    topic: str,
    *fields: str,
    type_name: str = "",
    on_missing: Callable[[str], None] | None = None,
) -> TopicArrays:
    """Return fields of a topic, such as `pose.pose.position.x`; without `fields`, all of them.

    `on_missing` is called with a sentence about each part that cannot be read. `type_name` chooses
    a type if the topic has several.

    Raises:
        UsageError: The recording has no such topic, or the topic's type has no such field.
        UnreadableFile: Nothing can be read; or, without `on_missing`, not everything.
    """
    missing: list[str] = []
    tell = on_missing or (lambda sentence: note_missing(missing, sentence))
    with Recording(path) as recording:
        listing = f"robotctl topic list --file {path}"
        chosen = choose_topic(recording.info(), topic, type_name, listing=listing)
        for sentence in recording.missing:
            tell(sentence)
        table = TopicTable(recording, chosen)
        wanted = {each: _places(table, each) for each in fields} or {
            column.name: range(place, place + 1)
            for place, column in enumerate(table.columns)
            if column not in TIME_COLUMNS
        }
        used = sorted({0, 1, 2, *(place for places in wanted.values() for place in places)})
        values: dict[int, list[Any]] = {place: [] for place in used}
        for row in table.rows(tell):
            for place, column_values in values.items():
                column_values.append(row[place])
    if missing:
        raise UnreadableFile(f"{path} is incomplete: {'; '.join(missing)}")
    arrays = {place: _array(table.columns[place], values[place]) for place in used}
    return TopicArrays(
        topic=chosen.name,
        type_name=chosen.type_name,
        log_ns=arrays[0],
        publish_ns=arrays[1],
        time_s=arrays[2],
        fields={name: _joined([arrays[each] for each in at]) for name, at in wanted.items()},
    )


def _places(table: TopicTable, path: str) -> Sequence[int]:
    """Return the positions of a field's columns in a row; an array has one column per item."""
    try:
        parse_path(table.definition, path)
    except WrongValue as error:
        raise UsageError(str(error)) from None
    names = [column.name for column in table.columns]
    if path in names:
        return [names.index(path)]
    items = [place for place, name in enumerate(names) if name.startswith(f"{path}[")]
    if items and all("." not in names[place][len(path) :] for place in items):
        return items
    raise UsageError(f"{path} is no number, text or list of them", "name a field below it")


def _array(column: FieldPath, values: Sequence[Any]) -> Array:
    if column.kind is ValueKind.NUMBER:
        return np.array(values, dtype=NUMBERS[column.field.type_name])
    items = column.kind is ValueKind.LIST and NUMBERS.get(column.field.type_name)
    array = np.empty(len(values), dtype=object)
    for place, value in enumerate(values):
        array[place] = np.array(value, dtype=items) if items else value
    return array


def _joined(columns: Sequence[Array]) -> Array:
    return columns[0] if len(columns) == 1 else np.stack(columns, axis=1)


_SQL_TYPES: Final = {
    "?": "BOOLEAN",
    "b": "TINYINT",
    "B": "UTINYINT",
    "h": "SMALLINT",
    "H": "USMALLINT",
    "i": "INTEGER",
    "I": "UINTEGER",
    "q": "BIGINT",
    "Q": "UBIGINT",
    "f": "FLOAT",
    "d": "DOUBLE",
}
"""The type of a column, by the `struct` code of its numbers; texts have none."""

_INTERRUPTED: Final = "Query interrupted"
_ERRNO = re.compile(r'"errno":"(\d+)"')
_FLOATS: Final = ("float32", "float64")

MAX_VALUES: Final = 1_000_000
"""Number of values in memory before a batch is written; a list or bytes count as their length."""

_MEMORY_LIMIT: Final = "1GB"
_GROUP_BYTES: Final = "64MB"


def write_parquet(columns: Sequence[FieldPath], rows: Iterable[Row], target: Path) -> int:
    """Write the rows into the new file `target`; return their number.

    Lists of numbers or texts become lists, lists of messages JSON, and bytes a BLOB. Temporary
    files in the folder of `target` need as much space as `target`.

    Raises:
        UsageError, RobotctlError: duckdb is not installed, or fails.
        UnreadableFile: A number does not fit into its column.
        OSError: The disk is full or fails.
    """
    duckdb = _duckdb()
    parts: list[Path] = []
    written = 0
    try:
        with duckdb.connect() as database, TemporaryDirectory(dir=target.parent) as folder:
            database.execute(f"SET threads=1; SET memory_limit='{_MEMORY_LIMIT}'")
            for batch in _batches(columns, rows):
                parts.append(Path(folder) / str(len(parts)))
                _write_part(database, columns, batch, parts[-1])
                written += len(batch)
            _join(database, parts, target)
    except duckdb.IOException as error:
        told = _ERRNO.search(str(error))
        code = int(told[1]) if told else errno.EIO
        raise OSError(code, os.strerror(code)) from error
    except RuntimeError as error:  # what duckdb makes of a KeyboardInterrupt
        if str(error) == _INTERRUPTED:
            raise KeyboardInterrupt from None
        raise
    except duckdb.Error as error:
        raise RobotctlError(f"duckdb cannot write {target.name}: {_first_line(error)}") from error
    return written


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise UsageError(
            "Parquet needs duckdb, which is not installed", "pip install 'robotctl[parquet]'"
        ) from None
    return duckdb


def _batches(columns: Sequence[FieldPath], rows: Iterable[Row]) -> Iterator[list[Row]]:
    """Yield the rows in batches that fit into memory; without rows, yield one empty batch."""
    long = [place for place, column in enumerate(columns) if column.kind is not ValueKind.NUMBER]
    batch: list[Row] = []
    values = 0
    any_batch = False
    for row in rows:
        batch.append(row)
        values += len(row) + sum(len(row[place]) for place in long)
        if values >= MAX_VALUES:
            yield batch
            batch, values, any_batch = [], 0, True
    if batch or not any_batch:
        yield batch


def _write_part(
    database: DuckDBPyConnection, columns: Sequence[FieldPath], batch: Sequence[Row], path: Path
) -> None:
    """Write a batch into the new Parquet file `path`."""
    values = zip(*batch, strict=True) if batch else ((),) * len(columns)
    try:
        arrays = {
            f"c{place}": _column(column, cells)
            for place, (column, cells) in enumerate(zip(columns, values, strict=True))
        }
    except OverflowError:
        raise UnreadableFile("a time of a message is beyond the year 2262") from None
    selected = ", ".join(
        f"{_restored(column, f'c{place}')} AS {_quoted(column.name)}"
        for place, column in enumerate(columns)
    )
    # duckdb finds the type of a list only by looking at all values of the batch.
    database.execute(f"SET pandas_analyze_sample={len(batch) + 1}")
    database.register("batch", arrays)
    database.execute(f"COPY (SELECT {selected} FROM batch) TO {_text(path)} (FORMAT parquet)")
    database.unregister("batch")


def _column(column: FieldPath, cells: Sequence[Any]) -> np.ndarray[Any, Any]:
    if column.kind is ValueKind.NUMBER:
        return np.array(cells, dtype=NUMBERS[column.field.type_name])
    array = np.empty(len(cells), dtype=object)
    nested = column.kind is ValueKind.NESTED
    for place, value in enumerate(cells):
        array[place] = json_of(value) if nested else value
    return array


def _restored(column: FieldPath, name: str) -> str:
    """Return SQL that casts a column to its type, and NULL to NaN, which duckdb reads as NULL."""
    if column.kind is ValueKind.BYTES:
        return f"CAST({name} AS BLOB)"
    if column.kind is ValueKind.NESTED:
        return f"CAST({name} AS VARCHAR)"
    kind = _SQL_TYPES.get(NUMBERS.get(column.field.type_name, ""), "VARCHAR")
    if column.kind is ValueKind.LIST:
        cast = f"CAST({name} AS {kind}[])"
        nan = f"list_transform({cast}, lambda x: coalesce(x, CAST('nan' AS {kind})))"
        return nan if column.field.type_name in _FLOATS else cast
    if column.field.type_name in _FLOATS:
        return f"coalesce({name}, CAST('nan' AS {kind}))"
    return f"CAST({name} AS {kind})"


def _join(database: DuckDBPyConnection, parts: Sequence[Path], target: Path) -> None:
    if len(parts) == 1:
        parts[0].rename(target)
        return
    listed = ", ".join(map(_text, parts))
    # With one thread the rows keep their order anyway. duckdb limits the bytes of row groups only
    # if it does not have to preserve the order.
    database.execute("SET preserve_insertion_order=false")
    database.execute(
        f"COPY (SELECT * FROM read_parquet([{listed}])) TO {_text(target)} "
        f"(FORMAT parquet, ROW_GROUP_SIZE_BYTES '{_GROUP_BYTES}')"
    )


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'


def _text(path: Path) -> str:
    return "'" + str(path).replace("'", "''") + "'"


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
