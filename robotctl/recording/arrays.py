"""Fields of a topic as NumPy arrays, and tables as Parquet (with the extra `parquet`)."""

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
from robotctl.recording.table import TIME_COLUMNS, Row, TopicTable, choose_topic, json_lines

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


Array = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True)
class TopicArrays:
    """Arrays with one entry per message of a topic, in the order of `log_ns`.

    `log_ns` and `publish_ns` are in ns since the epoch, `time_s` in seconds since the first message
    of the recording. A fixed array of n numbers has n columns. Texts, bytes and sequences have
    dtype object.
    """

    topic: str
    type_name: str
    log_ns: Array
    publish_ns: Array
    time_s: Array
    fields: Mapping[str, Array]

    def __getitem__(self, path: str) -> Array:
        """Return the array of the field `path`, or raise KeyError if it was not read."""
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
    """Return the arrays of `fields` of `topic`, or of all fields if none is given.

    `on_missing` gets a sentence per unreadable part. `type_name` selects one of a topic's types.

    Raises:
        UsageError: The recording lacks the topic or a field, or the topic has several types.
        UnreadableFile: Nothing can be read or, without `on_missing`, a part cannot be read.
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
    """Return the numbers of the columns that hold the field `path`: several for a fixed array."""
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
"""SQL type of a column by the `struct` code of its numbers."""

_INTERRUPTED: Final = "Query interrupted"
_ERRNO = re.compile(r'"errno":"(\d+)"')
_MEMORY_LIMIT: Final = "1GB"
_GROUP_BYTES: Final = "64MB"
_MAX_TIME_NS: Final = 2**63 - 1
_LEAST_LINE: Final = 1 << 24
"""Least limit for a line of JSON [bytes]. duckdb allocates as much as the limit."""


def write_parquet(columns: Sequence[FieldPath], rows: Iterable[Row], target: Path) -> int:
    """Write `rows` into the Parquet file `target`, and return their number.

    Lists of messages become JSON text. The folder of `target` needs room for the rows as JSON
    lines.

    Raises:
        UsageError, RobotctlError: duckdb is not installed, or fails.
        UnreadableFile: A time is beyond the year 2262.
        OSError: The disk is full or fails.
    """
    duckdb = _duckdb()
    written, longest = 0, _LEAST_LINE
    try:
        with duckdb.connect() as database, TemporaryDirectory(dir=target.parent) as folder:
            path = Path(folder, "rows.jsonl")
            with path.open("w", encoding="ascii") as lines:
                for line in json_lines(columns, _in_range(rows)):
                    lines.write(line)
                    written, longest = written + 1, max(longest, len(line))
            _copy(database, columns, path, longest, target)
    except duckdb.IOException as error:
        told = _ERRNO.search(str(error))
        code = int(told[1]) if told else errno.EIO
        raise OSError(code, os.strerror(code)) from error
    except RuntimeError as error:  # duckdb turns a KeyboardInterrupt into this
        if str(error) == _INTERRUPTED:
            raise KeyboardInterrupt from None
        raise
    except duckdb.Error as error:
        reason = str(error).partition("\n")[0]
        raise RobotctlError(f"duckdb cannot write {target.name}: {reason}") from error
    return written


def _in_range(rows: Iterable[Row]) -> Iterator[Row]:
    for row in rows:
        if max(row[:2]) > _MAX_TIME_NS:
            raise UnreadableFile("a time of a message is beyond the year 2262")
        yield row


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise UsageError(
            "Parquet needs duckdb, which is not installed", "pip install 'robotctl[parquet]'"
        ) from None
    return duckdb


def _copy(
    database: DuckDBPyConnection,
    columns: Sequence[FieldPath],
    lines: Path,
    longest: int,
    target: Path,
) -> None:
    """Copy the `lines` of JSON, each of at most `longest` bytes, into the Parquet file `target`."""
    types = ", ".join(f"{_quoted(column.name)}: {_quoted(_sql_type(column))}" for column in columns)
    selected = ", ".join(
        f"from_base64({name}) AS {name}" if column.kind is ValueKind.BYTES else name
        for column in columns
        for name in [_quoted(column.name, '"')]
    )
    # With one thread the rows keep their order anyway. duckdb limits the bytes of row groups only
    # if it does not have to preserve the order.
    database.execute(f"SET threads=1; SET memory_limit='{_MEMORY_LIMIT}'")
    database.execute("SET preserve_insertion_order=false")
    database.execute(
        f"COPY (SELECT {selected} FROM read_json({_quoted(lines)}, format='newline_delimited', "
        f"columns={{{types}}}, maximum_object_size={longest})) TO {_quoted(target)} "
        f"(FORMAT parquet, ROW_GROUP_SIZE_BYTES '{_GROUP_BYTES}')"
    )


def _sql_type(column: FieldPath) -> str:
    number = _SQL_TYPES.get(NUMBERS.get(column.field.type_name, ""), "VARCHAR")
    if column.kind is ValueKind.LIST:
        return f"{number}[]"
    return number if column.kind is ValueKind.NUMBER else "VARCHAR"


def _quoted(value: object, quote: str = "'") -> str:
    return quote + str(value).replace(quote, 2 * quote) + quote
