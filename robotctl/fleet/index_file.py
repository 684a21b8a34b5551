"""The index of a recording: one Parquet file beside it, with the rows of `rows`.

It names the recording's files by size and time of change, and is made again when these differ.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryFile
from typing import Final

from robotctl.errors import Refused
from robotctl.fleet.database import file_of, name, text, write_parquet
from robotctl.fleet.rows import IndexRow, RecordingRow, all_columns
from robotctl.recording.disk.storage import is_being_written
from robotctl.recording.format.derived_files import INDEX_FILE
from robotctl.recording.format.natural_order import natural_order
from robotctl.recording.format.rosbag2 import entries_of
from robotctl.store import is_hash

LAYOUT: Final = 1
"""The number of the columns' layout; an index with another one is made again."""


def index_path(recording: Path) -> Path:
    """Return where the index of a recording is; that of a single file is FILE.index.parquet."""
    if recording.suffix == ".mcap":
        return recording.with_name(f"{recording.name}.{INDEX_FILE}")
    return recording / INDEX_FILE


def index_path_text(recording: str) -> str:
    """Return the path of a local index as text; for 10,000 recordings this saves a second."""
    return (
        f"{recording}.{INDEX_FILE}" if recording.endswith(".mcap") else f"{recording}/{INDEX_FILE}"
    )


def files_of(recording: Path | str) -> list[str]:
    """Return the MCAP files of a recording; links are among them.

    Raises:
        OSError: The recording cannot be read.
    """
    path = str(recording)
    if path.endswith(".mcap"):
        return [path]
    with os.scandir(path) as entries:
        names = [each.name for each in entries]
    if any(map(is_hash, names)):  # a copy of an earlier robotctl
        return [str(each) for each in entries_of(Path(path)) if each.suffix == ".mcap"]
    return [f"{path}/{name}" for name in names if name.endswith(".mcap")]


def closed_files(files: Iterable[Path | str]) -> list[Path]:
    """Return those files of a recording that no process is writing any more, in their order.

    Raises:
        OSError: One cannot be opened.
    """
    paths = sorted(map(Path, files), key=natural_order)
    return [each for each in paths if not is_being_written(each)]


def stamp_of(files: Iterable[Path | str]) -> str:
    """Return a text that is another one after these files have changed.

    Raises:
        OSError: One is gone.
    """
    stats = ((os.path.basename(each), os.lstat(each)) for each in files)
    listed = sorted((name, stat.st_size, stat.st_mtime_ns) for name, stat in stats)
    return f"{LAYOUT}-{hashlib.sha256(repr(listed).encode()).hexdigest()[:32]}"


def write_index(target: Path, recording: str, rows: Sequence[IndexRow], stamp: str) -> None:
    """Write the index of a recording of that name.

    Raises:
        Refused: It cannot be written.
        UsageError: duckdb is not installed.
    """
    columns = ", ".join(f"{name(key)}: {text(kind)}" for key, kind in table_columns().items())
    try:
        with TemporaryFile() as file:
            file.writelines(_lines(rows, {"stamp": stamp, "recording": recording}))
            file.flush()
            lines = file_of(file)
            query = (
                f"SELECT * FROM read_json({text(lines)}, format='newline_delimited', "
                f"columns={{{columns}}})"
            )
            write_parquet(target, query, [lines], ", PARQUET_VERSION v2")
    except OSError as error:
        raise Refused(f"cannot write {target}: {error.strerror or error}") from error


def _lines(rows: Iterable[IndexRow], first: dict[str, str]) -> Iterable[bytes]:
    for row in rows:
        extra = {"stamp": first["stamp"]} if isinstance(row, RecordingRow) else {}
        values = {"recording": first["recording"], "kind": row.kind, **extra, **asdict(row)}
        known = {key: value for key, value in values.items() if value is not None}
        yield f"{json.dumps(known)}\n".encode()


def table_columns() -> dict[str, str]:
    """Return all columns of an index file with their types."""
    return {"recording": "VARCHAR", "stamp": "VARCHAR", **all_columns()}
