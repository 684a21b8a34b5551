"""DuckDB in memory, without access to the network or to files other than those it is given."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from errno import ENOSPC
from glob import escape
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from robotctl.base.errors import UsageError
from robotctl.recording.disk.atomic_output import replaced_file

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


READING: Final = "120MB"
"""DuckDB's memory limit for a question; the process needs 60 MB more."""

WRITING: Final = "1GB"
"""DuckDB's memory limit while it writes a file."""

ABANDONED_S: Final = 3600.0
"""An unfinished file that is unchanged for this time was left by a killed process."""


@contextmanager
def database(
    files: Sequence[Path | str] = (), memory: str = READING
) -> Iterator[DuckDBPyConnection]:
    """Open a database in memory that can access only `files`, and load no extensions.

    Queries cannot lift these limits. `memory` is DuckDB's memory limit, such as "120MB".

    Raises:
        UsageError: duckdb is not installed.
    """
    try:
        import duckdb
    except ImportError:
        raise UsageError(
            "an index needs duckdb, which is not installed", "pip install 'robotctl[parquet]'"
        ) from None
    with duckdb.connect(":memory:", config={"memory_limit": memory}) as connection:
        connection.execute("SET temp_directory = ''; SET preserve_insertion_order = false")
        connection.execute("SET enable_progress_bar = false")  # it would be printed into an answer
        allowed = {*map(str, files), *map(_pattern, files)}
        connection.execute(f"SET allowed_paths = [{', '.join(map(text, sorted(allowed)))}]")
        for name, value in _CLOSED.items():
            connection.execute(f"SET {name} = {value}")
        yield connection


_CLOSED: Final[Mapping[str, str]] = {
    "autoinstall_known_extensions": "false",
    "autoload_known_extensions": "false",
    "enable_external_access": "false",
    "python_enable_replacements": "false",
    "lock_configuration": "true",
}
"""`lock_configuration` must be last: after it, nothing can be set."""


def write_parquet(
    target: Path, query: str, sources: Sequence[Path | str], options: str = ""
) -> None:
    """Replace `target` by the rows of `query`, which reads `sources`; on failure, change nothing.

    Raises:
        OSError: The file cannot be written, or a source cannot be read.
        UsageError: duckdb is not installed.
    """
    _remove_abandoned(target)
    with replaced_file(target) as stream:
        path = file_of(stream)
        with database([*sources, path], WRITING) as connection:
            import duckdb

            try:
                connection.execute(
                    f"COPY ({query}) TO {text(path)} "
                    f"(FORMAT parquet, COMPRESSION zstd, USE_TMP_FILE false{options})"
                )
            except duckdb.Error as error:
                if not os.fstatvfs(stream.fileno()).f_bavail:
                    raise OSError(ENOSPC, os.strerror(ENOSPC)) from error
                raise OSError(" ".join(str(error).split())[:300]) from error


def file_of(stream: IO[bytes]) -> str:
    """Return a path that names an open file even after the file is renamed or replaced."""
    return f"/proc/self/fd/{stream.fileno()}"


def _remove_abandoned(target: Path) -> None:
    """Remove unfinished copies of `target` by killed processes, and `target` if it is a link."""
    with suppress(OSError):
        if target.is_symlink():
            target.unlink()
        for unfinished in target.parent.glob(f".{escape(target.name)}.*.tmp"):
            if time.time() - unfinished.lstat().st_mtime > ABANDONED_S:
                unfinished.unlink()


def parquet(paths: Iterable[Path | str], options: str = "") -> str:
    """Return the SQL call that reads the Parquet files `paths`; `options` begin with a comma."""
    return f"read_parquet([{patterns(paths)}], hive_partitioning = false{options})"


def patterns(paths: Iterable[Path | str]) -> str:
    """Return paths as SQL strings, separated by commas; glob characters are escaped."""
    return ", ".join(text(_pattern(each)) for each in paths)


def _pattern(path: Path | str) -> str:
    return re.sub(r"[*?[]", r"[\g<0>]", str(path))


def text(value: object) -> str:
    """Return the value as an SQL string literal."""
    return "'" + str(value).replace("'", "''") + "'"


def name(value: str) -> str:
    """Return the name as a quoted SQL identifier."""
    return '"' + value.replace('"', '""') + '"'
