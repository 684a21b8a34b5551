"""Answers questions over the catalogue of a folder: a condition over rows, or SQL.

A condition such as `laps >= 1 and max_error_m > 0.1` is in Python's syntax. It is translated to
SQL, never evaluated.
"""

from __future__ import annotations

import ast
import os
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from robotctl.base.errors import Refused, UsageError
from robotctl.collection.catalogue import Catalogue
from robotctl.collection.index_file import (
    DriveRow,
    EventRow,
    RecordingRow,
    SampleRow,
    TopicRow,
    columns,
    database,
    name,
    parquet,
)

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


MAX_CHARACTERS: Final = 2000

_COMPARISONS: Final[dict[type[ast.cmpop], str]] = {
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Eq: "=",
    ast.NotEq: "<>",
    ast.GtE: ">=",
    ast.Gt: ">",
}
_ARITHMETIC: Final[dict[type[ast.operator], str]] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
}
_CURE: Final = "write it like: laps >= 1 and max_error_m > 0.1"


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition in SQL, and the values of its placeholders, in order."""

    sql: str
    values: tuple[Any, ...]


def parse_condition(source: str, columns: Collection[str]) -> Condition:
    """Return the condition `source` over `columns` as SQL.

    Raises:
        UsageError: The text is not a condition, or names an unknown column.
    """
    if len(source) > MAX_CHARACTERS:
        raise UsageError(f"the condition has more than {MAX_CHARACTERS} characters")
    try:
        tree = ast.parse(source.strip(), mode="eval").body
        parser = _Parser(columns)
        sql = parser.sql(tree)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        hint = "compare with ==, not =" if "=" in source and "==" not in source else _CURE
        raise UsageError(f"{_shown(source)} is not a condition", hint) from None
    return Condition(sql, tuple(parser.values))


def known_column(wanted: str, columns: Collection[str]) -> str:
    """Return `wanted` if it is one of the columns.

    Raises:
        UsageError: There is no such column.
    """
    if wanted in columns:
        return wanted
    near = get_close_matches(wanted, columns, n=1)
    cure = f"did you mean {near[0]}?" if near else f"there are: {', '.join(columns)}"
    raise UsageError(f"there is no column {_shown(wanted)}", cure)


class _Parser:
    """Translates the tree of a condition to SQL, or raises ValueError."""

    def __init__(self, columns: Collection[str]) -> None:
        self._columns = columns
        self.values: list[Any] = []

    def sql(self, node: ast.expr) -> str:
        match node:
            case ast.BoolOp():
                word = " AND " if isinstance(node.op, ast.And) else " OR "
                return f"({word.join(map(self.sql, node.values))})"
            case ast.UnaryOp(op=ast.Not()):
                return f"(NOT {self.sql(node.operand)})"
            case ast.UnaryOp(op=ast.USub()):
                return f"(- {self.sql(node.operand)})"
            case ast.BinOp() if type(node.op) in _ARITHMETIC:
                sign = _ARITHMETIC[type(node.op)]
                return f"({self.sql(node.left)} {sign} {self.sql(node.right)})"
            case ast.Compare():
                return self._comparison(node)
            case ast.Name():
                return name(known_column(node.id, self._columns))
            case ast.Constant(value=str() | int() | float() as value):
                self.values.append(value)
                return "?"
        raise ValueError

    def _comparison(self, node: ast.Compare) -> str:
        parts = []
        left = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            parts.append(self._one(left, operator, right))
            left = right
        return f"({' AND '.join(parts)})"

    def _one(self, left: ast.expr, operator: ast.cmpop, right: ast.expr) -> str:
        if isinstance(right, ast.Constant) and right.value is None:
            if isinstance(operator, ast.Eq | ast.Is):
                return f"{self.sql(left)} IS NULL"
            if isinstance(operator, ast.NotEq | ast.IsNot):
                return f"{self.sql(left)} IS NOT NULL"
        if type(operator) not in _COMPARISONS:
            raise ValueError
        return f"{self.sql(left)} {_COMPARISONS[type(operator)]} {self.sql(right)}"


def _shown(source: str) -> str:
    return repr(source if len(source) <= 60 else source[:57] + "...")


TABLES: Final[dict[str, type[Any]]] = {
    "recordings": RecordingRow,
    "drives": DriveRow,
    "events": EventRow,
    "topics": TopicRow,
}
"""The tables of a catalogue, with their classes of rows."""

SAMPLES: Final = "samples"
"""The table that is read from the indexes of the recordings."""

_QUESTION: Final = "robotctl_question"
"""The name of the temporary view that checks a user's query."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The rows that a question found, with the names of their columns."""

    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def as_objects(self) -> list[dict[str, Any]]:
        """Return each row as a dict of its values by column name."""
        return [dict(zip(self.columns, row, strict=True)) for row in self.rows]


def columns_of(table: str) -> tuple[str, ...]:
    """Return the names of all columns of a table in `TABLES`."""
    return ("recording", *columns(TABLES[table]))


def find(
    catalogue: Catalogue, table: str, condition: str, sort: str = "", limit: int = 0
) -> Answer:
    """Return the rows of a table that meet `condition`; all rows if `condition` is "".

    `sort` is a column, with a "-" before it for descending order; "" sorts by `start_ns`, or by
    `recording` if the table lacks that. A `limit` of 0 means no limit.

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
    """Run a user's read-only SQL query over `TABLES` and `SAMPLES`, and return the answer.

    Raises:
        UsageError: The query is wrong, or does more than read.
        Refused: An index was removed meanwhile.
    """
    return _run(catalogue, sql, None)


def _run(catalogue: Catalogue, sql: str, values: Sequence[Any] | None) -> Answer:
    """Run a query, after a check if `values` is None."""
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
    """Create a view of each table, of the samples only if there are `indexes`."""
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
    """Raise an error for a query that could write into the files that the database may read."""
    import duckdb

    statements = connection.extract_statements(sql)
    if [each.type for each in statements] != [duckdb.StatementType.SELECT]:
        raise UsageError("the question cannot be answered: it is not one SELECT statement")
    # A SELECT may write in its WITH clause; a view must not contain such a clause.
    connection.execute(f"CREATE TEMP VIEW {_QUESTION} AS {sql}")
