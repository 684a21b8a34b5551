"""The index of a recording: one Parquet file beside it, with the rows of `rows`.

It names the recording's files by size and time of change, and is made again when these differ.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from robotctl.errors import Refused
from robotctl.fleet.database import database, name, text
from robotctl.fleet.rows import IndexRow, RecordingRow, all_columns
from robotctl.recording.disk.access import protect_like
from robotctl.recording.format.derived_files import INDEX_FILE

LAYOUT: Final = 1
"""The number of the columns' layout; an index with another one is made again."""


def index_path(recording: Path) -> Path:
    """Return where the index of a recording is; that of a single file is FILE.index.parquet."""
    if recording.suffix == ".mcap":
        return recording.with_name(f"{recording.name}.{INDEX_FILE}")
    return recording / INDEX_FILE


def stamp_of(recording: Path) -> str:
    """Return a text that is another one after the recording has changed, "" without MCAP files.

    Raises:
        OSError: The recording cannot be read.
    """
    if recording.suffix == ".mcap":
        stats = [(recording.name, recording.stat(follow_symlinks=False))]
    else:
        with os.scandir(recording) as entries:
            found = [each for each in entries if each.name.endswith(".mcap")]
            stats = [(each.name, each.stat(follow_symlinks=False)) for each in found]
    if not stats:
        return ""
    listed = sorted((each, stat.st_size, stat.st_mtime_ns) for each, stat in stats)
    return f"{LAYOUT}-{hashlib.sha256(repr(listed).encode()).hexdigest()[:32]}"


def write_index(recording: Path, rows: Sequence[IndexRow], stamp: str) -> Path:
    """Write the index of a recording and return its path.

    Raises:
        Refused: It cannot be written, or duckdb is not installed.
    """
    target = index_path(recording)
    try:
        with tempfile.TemporaryDirectory(prefix=".index-", dir=target.parent) as folder:
            lines, made = Path(folder, "rows"), Path(folder, INDEX_FILE)
            with lines.open("w", encoding="utf-8") as file:
                file.writelines(_lines(rows, {"stamp": stamp, "recording": recording.name}))
            _write_table(lines, made)
            protect_like(made, recording)
            made.replace(target)
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror or error}") from error
    return target


def _lines(rows: Iterable[IndexRow], first: dict[str, str]) -> Iterable[str]:
    for row in rows:
        extra = {"stamp": first["stamp"]} if isinstance(row, RecordingRow) else {}
        values = {"recording": first["recording"], "kind": row.kind, **extra, **asdict(row)}
        yield json.dumps({key: value for key, value in values.items() if value is not None}) + "\n"


def _write_table(lines: Path, target: Path) -> None:
    """Turn rows, a JSON object a line, into a Parquet file.

    Raises:
        OSError: The file cannot be written.
        Refused: duckdb is not installed.
    """
    columns = ", ".join(f"{name(key)}: {text(kind)}" for key, kind in table_columns().items())
    with database(writable=target.parent) as connection:
        import duckdb

        try:
            connection.execute(
                f"COPY (SELECT * FROM read_json({text(lines)}, format='newline_delimited', "
                f"columns={{{columns}}})) TO {text(target)} "
                f"(FORMAT parquet, PARQUET_VERSION v2, COMPRESSION zstd)"
            )
        except duckdb.IOException as error:
            raise OSError(str(error)) from error


def table_columns() -> dict[str, str]:
    """Return all columns of an index file with their types."""
    return {"recording": "VARCHAR", "stamp": "VARCHAR", **all_columns()}
