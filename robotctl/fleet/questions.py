"""Answers questions over the catalogue of a folder: a condition over rows, or SQL."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from robotctl.errors import Refused, UsageError
from robotctl.fleet.catalogue import Catalogue
from robotctl.fleet.condition import known_column, parse_condition
from robotctl.fleet.database import database, name, parquet
from robotctl.fleet.rows import (
    DriveRow,
    EventRow,
    RecordingRow,
    SampleRow,
    TopicRow,
    columns,
)

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

TABLES: Final[dict[str, type[Any]]] = {
    "recordings": RecordingRow,
    "drives": DriveRow,
    "events": EventRow,
    "topics": TopicRow,
}
"""The tables of a catalogue, each with its class of rows."""

SAMPLES: Final = "samples"
"""The table that is read from the indexes themselves."""

_QUESTION: Final = "robotctl_question"
"""A view that no user's query names."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The rows that a question found, with the names of their columns."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def as_objects(self) -> list[dict[str, Any]]:
        """Return each row as an object."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


def columns_of(table: str) -> tuple[str, ...]:
    """Return the columns of a table."""
    return ("recording", *columns(TABLES[table]))


def find(
    catalogue: Catalogue, table: str, condition: str, sort: str = "", limit: int = 0
) -> Answer:
    """Return the rows of a table for which a condition holds, "" for all.

    They are sorted by a column, in falling order if its name begins with "-"; by the time if it is
    "", and rows without a time by their recording.

    Raises:
        UsageError: The condition or the column is wrong.
        Refused: An index was removed meanwhile.
    """
    known = columns_of(table)
    by_default = "start_ns" if "start_ns" in known else "recording"
    order = name(known_column(sort.removeprefix("-") or by_default, known))
    falling = " DESC" if sort.startswith("-") else ""
    where = parse_condition(condition, known) if condition else None
    sql = f"SELECT {', '.join(map(name, known))} FROM {table}"
    if where is not None:
        sql += f" WHERE {where.sql}"
    sql += f" ORDER BY {order}{falling} NULLS LAST, recording"
    if limit:
        sql += f" LIMIT {limit}"
    return _run(catalogue, sql, () if where is None else where.values)


def ask(catalogue: Catalogue, sql: str) -> Answer:
    """Return what a query in SQL over `TABLES` and `SAMPLES` gives; it can write nothing.

    Raises:
        UsageError: The query is wrong, or does more than to read.
        Refused: An index was removed meanwhile.
    """
    return _run(catalogue, sql, None)


def _run(catalogue: Catalogue, sql: str, values: Sequence[Any] | None) -> Answer:
    """Run a query; one without `values` comes from a user, and must be harmless."""
    indexes = _present(catalogue.indexes) if SAMPLES in sql.lower() else []
    with database([catalogue.path, *indexes]) as connection:
        import duckdb

        try:
            _make_tables(connection, catalogue.path, indexes)
            if values is None:
                _check_reads_only(connection, sql)
            found = connection.execute(sql, list(values or ()))
            rows = tuple(found.fetchall())
        except duckdb.Error as error:
            said = " ".join(str(error).split())[:300]
            is_gone = len(_present([catalogue.path, *indexes])) <= len(indexes)
            if is_gone or isinstance(error, duckdb.IOException):
                raise Refused(f"an index cannot be read any more: {said}", "ask again") from None
            raise UsageError(f"the question cannot be answered: {said}") from None
        return Answer(tuple(each[0] for each in found.description or ()), rows)


def _present(paths: Iterable[Path | str]) -> list[Path | str]:
    return [each for each in paths if os.path.exists(each)]


def _make_tables(
    connection: DuckDBPyConnection, catalogue: Path, indexes: Sequence[Path | str]
) -> None:
    """Make a view of each table; that of the samples only if there are `indexes`."""
    source = parquet([catalogue])
    for table, kind in TABLES.items():
        names = ", ".join(map(name, columns_of(table)))
        connection.execute(
            f"CREATE VIEW {table} AS SELECT {names} FROM {source} WHERE kind = '{kind.kind}'"
        )
    if indexes:
        names = ", ".join(map(name, ("recording", *columns(SampleRow))))
        connection.execute(
            f"CREATE VIEW {SAMPLES} AS SELECT {names} FROM {parquet(indexes)} "
            f"WHERE kind = '{SampleRow.kind}'"
        )


def _check_reads_only(connection: DuckDBPyConnection, sql: str) -> None:
    """Refuse what could write into the files that the database may read.

    One statement that selects may still write, in its WITH clause. A view may not.

    Raises:
        UsageError: It is not one statement that selects.
        duckdb.Error: It is wrong, or writes.
    """
    import duckdb

    statements = connection.extract_statements(sql)
    if [each.type for each in statements] != [duckdb.StatementType.SELECT]:
        raise UsageError("the question cannot be answered: it is not one SELECT statement")
    connection.execute(f"CREATE TEMP VIEW {_QUESTION} AS {sql}")
