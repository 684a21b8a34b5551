"""The index of a recording: one Parquet file with rows about its content.

Times `..._ns` are since the epoch. NULL means unknown, or that the row's `kind` lacks the column.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, fields
from errno import ENOSPC
from glob import escape
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, TYPE_CHECKING, Any, ClassVar, Final

from robotctl.base.errors import Refused, UsageError
from robotctl.base.files import remove_abandoned
from robotctl.base.store.objects import is_hash
from robotctl.recording.format.disk import is_being_written, replaced_file
from robotctl.recording.format.names import INDEX_FILE, natural_order
from robotctl.recording.format.rosbag2 import entries_of

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection


READING: Final = "120MB"
"""DuckDB's memory limit for a question."""

WRITING: Final = "1GB"
"""DuckDB's memory limit while it writes a file."""


@contextmanager
def database(
    files: Sequence[Path | str] = (), memory: str = READING
) -> Iterator[DuckDBPyConnection]:
    """Open a database in memory that can access only `files`.

    `memory` is DuckDB's memory limit, such as "120MB".

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
        connection.execute("SET enable_progress_bar = false")  # it would be printed amid the answer
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
    "lock_configuration": "true",  # last: it forbids all further changes
}
"""The settings that limit a database."""


def write_parquet(
    target: Path, query: str, sources: Sequence[Path | str], options: str = ""
) -> None:
    """Write the rows of the SQL `query` over the files `sources` to `target`, or change nothing.

    Raises:
        OSError: The file cannot be written, or a source cannot be read.
        UsageError: duckdb is not installed.
    """
    with suppress(OSError):
        if target.is_symlink():
            target.unlink()
    remove_abandoned(target.parent, f".{escape(target.name)}.*.tmp")
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


def parquet(paths: Iterable[Path | str], options: str = "") -> str:
    """Return the SQL call that reads the Parquet files `paths`; `options` begins with a comma."""
    return f"read_parquet([{patterns(paths)}], hive_partitioning = false{options})"


def patterns(paths: Iterable[Path | str]) -> str:
    """Return paths as SQL strings with escaped glob characters, separated by commas."""
    return ", ".join(text(_pattern(each)) for each in paths)


def _pattern(path: Path | str) -> str:
    return re.sub(r"[*?[]", r"[\g<0>]", str(path))


def text(value: object) -> str:
    """Return `value` as an SQL string literal."""
    return "'" + str(value).replace("'", "''") + "'"


def name(value: str) -> str:
    """Return the name as a quoted SQL identifier."""
    return '"' + value.replace('"', '""') + '"'


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """A recording: its size, software, totals and verdicts.

    `software` is a digest. `parameters` is the JSON of the kernel's first parameters.
    """

    kind: ClassVar[str] = "recording"

    robot: str
    start_ns: int
    duration_s: float
    size_bytes: int
    files: int
    messages: int
    lost: int
    version: str
    software: str
    parameters: str | None
    drives: int
    laps: int
    distance_m: float
    max_error_m: float | None
    stops: int
    check: str
    check_says: str | None
    verify: str


@dataclass(frozen=True, slots=True)
class DriveRow:
    """A drive, numbered from 1 in its recording.

    `wanted_laps` is 0 if endless. In an unfinished drive, `duration_s` and all after it are None.
    """

    kind: ClassVar[str] = "drive"

    drive: int
    robot: str
    start_ns: int
    pattern: str | None
    wanted_laps: int | None
    asked_by: str
    duration_s: float | None = None
    laps: int | None = None
    completed: bool | None = None
    ended: str | None = None
    cause: str | None = None
    distance_m: float | None = None
    rms_error_m: float | None = None
    max_error_m: float | None = None
    closure_m: float | None = None
    rms_heading_rad: float | None = None
    max_heading_rad: float | None = None


@dataclass(frozen=True, slots=True)
class EventRow:
    """A change of mode, a refusal, or an event noted in the recording (see `EventKind`)."""

    kind: ClassVar[str] = "event"

    event: str
    start_ns: int
    mode: str | None
    text: str
    cause: str | None = None


@dataclass(frozen=True, slots=True)
class TopicRow:
    """A topic with its recorded and lost messages and its mean rate."""

    kind: ClassVar[str] = "topic"

    topic: str
    type: str
    messages: int
    lost: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class SampleRow:
    """The robot's pose by odometry, command, mode and distance from the reference at one moment."""

    kind: ClassVar[str] = "sample"

    drive: int | None
    start_ns: int
    mode: str
    x_m: float | None
    y_m: float | None
    theta_rad: float | None
    linear_mps: float | None
    angular_rps: float | None
    error_m: float | None


IndexRow = RecordingRow | DriveRow | EventRow | TopicRow | SampleRow

KINDS: tuple[type[Any], ...] = (RecordingRow, DriveRow, EventRow, TopicRow, SampleRow)

_SQL_TYPES = {"str": "VARCHAR", "int": "BIGINT", "float": "DOUBLE", "bool": "BOOLEAN"}

_SINGLE_PRECISION = ("x_m", "y_m", "theta_rad", "linear_mps", "angular_rps", "error_m")
"""Columns stored as FLOAT to keep files small."""


def columns(kind: type[Any]) -> dict[str, str]:
    """Return the columns of a class of rows, with their types in SQL."""
    return {
        each.name: "FLOAT"
        if each.name in _SINGLE_PRECISION
        else _SQL_TYPES[str(each.type).removesuffix(" | None")]
        for each in fields(kind)
    }


def all_columns() -> dict[str, str]:
    """Return {column: SQL type} with the columns of all classes of rows, `kind` first."""
    found = {"kind": "VARCHAR"}
    for kind in KINDS:
        found |= columns(kind)
    return found


LAYOUT: Final = 1
"""The version of the column layout."""


def index_path(recording: Path) -> Path:
    """Return the path of a recording's index."""
    if recording.suffix == ".mcap":
        return recording.with_name(f"{recording.name}.{INDEX_FILE}")
    return recording / INDEX_FILE


def index_path_text(recording: str) -> str:
    """Return the path of a recording's index as text, 30 times as fast as `index_path`."""
    return (
        f"{recording}.{INDEX_FILE}" if recording.endswith(".mcap") else f"{recording}/{INDEX_FILE}"
    )


def files_of(recording: Path | str) -> list[str]:
    """Return the MCAP files of a recording, including links.

    Raises:
        OSError: The recording cannot be read.
    """
    path = str(recording)
    if path.endswith(".mcap"):
        return [path]
    with os.scandir(path) as entries:
        names = [each.name for each in entries]
    if any(map(is_hash, names)):  # a copy that an earlier robotctl made
        return [str(each) for each in entries_of(Path(path)) if each.suffix == ".mcap"]
    return [f"{path}/{name}" for name in names if name.endswith(".mcap")]


def closed_files(files: Iterable[Path | str]) -> list[Path]:
    """Return the files that no process is writing, in natural order.

    Raises:
        OSError: A file cannot be opened.
    """
    paths = sorted(map(Path, files), key=natural_order)
    return [each for each in paths if not is_being_written(each)]


def stamp_of(files: Iterable[Path | str]) -> str:
    """Return a text that changes with the index layout, and with files' names, sizes and mtimes.

    Raises:
        OSError: A file does not exist any more.
    """
    stats = ((os.path.basename(each), os.lstat(each)) for each in files)
    listed = sorted((name, stat.st_size, stat.st_mtime_ns) for name, stat in stats)
    return f"{LAYOUT}-{hashlib.sha256(repr(listed).encode()).hexdigest()[:32]}"


def write_index(target: Path, recording: str, rows: Sequence[IndexRow], stamp: str) -> None:
    """Write an index of the recording with the name `recording` to the file `target`.

    Raises:
        Refused: The file cannot be written.
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
    """Return {column: SQL type} of an index, `recording` and `stamp` first."""
    return {"recording": "VARCHAR", "stamp": "VARCHAR", **all_columns()}
