"""DuckDB in memory, closed to the network and to all files but those it is given."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

from robotctl.errors import UsageError

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

READING: Final = "120MB"
"""What a question may take; the process needs 60 MB beside it."""

WRITING: Final = "1GB"
"""What a file may take that is being written."""


@contextmanager
def database(
    readable: Sequence[Path] = (), writable: Path | None = None
) -> Iterator[DuckDBPyConnection]:
    """Open a database that may read the files `readable`, and read and write below `writable`.

    It loads no extension, and what is run in it cannot change that.

    Raises:
        UsageError: duckdb is not installed.
    """
    try:
        import duckdb
    except ImportError:
        raise UsageError(
            "an index needs duckdb, which is not installed", "pip install 'robotctl[parquet]'"
        ) from None
    with duckdb.connect(
        ":memory:", config={"memory_limit": READING if writable is None else WRITING}
    ) as connection:
        connection.execute("SET temp_directory = ''; SET preserve_insertion_order = false")
        connection.execute(f"SET allowed_paths = [{', '.join(map(text, readable))}]")
        if writable is not None:
            connection.execute(f"SET allowed_directories = [{text(writable)}]")
        for name, value in _CLOSED.items():
            connection.execute(f"SET {name} = {value}")
        yield connection


_CLOSED: Final[Mapping[str, str]] = {
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
    "enable_external_access": "false",
    "lock_configuration": "true",
}
"""The last one must be last: it lets nothing be set after it."""


def text(value: object) -> str:
    """Return the value as a string in SQL."""
    return "'" + str(value).replace("'", "''") + "'"


def name(value: str) -> str:
    """Return a name in SQL, whatever its characters."""
    return '"' + value.replace('"', '""') + '"'
