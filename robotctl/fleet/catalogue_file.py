"""Writes a catalogue: the rows of many indexes in one Parquet file, without the samples."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from robotctl.errors import Refused
from robotctl.fleet.database import parquet, text, write_parquet
from robotctl.fleet.index_file import table_columns


def write_catalogue(
    targets: Iterable[Path], before: str | None, kept: Collection[str], indexes: Sequence[Path]
) -> Path:
    """Write a catalogue: of the one before, the recordings `kept`, and the indexes.

    Returns the first of `targets` that can be written.

    Raises:
        Refused: None of them.
    """
    parts = []
    if before is not None:
        names = ", ".join(map(text, kept))
        parts.append(f"SELECT * FROM {parquet([before])} WHERE recording IN ({names})")
    if indexes:
        parts.append(f"SELECT * FROM {parquet(indexes)} WHERE kind <> 'sample'")
    if not parts:
        columns = ", ".join(f'NULL::{kind} AS "{key}"' for key, kind in table_columns().items())
        parts.append(f"SELECT {columns} WHERE false")
    sources: list[Path | str] = [*indexes, *([] if before is None else [before])]
    failure = ""
    for target in targets:
        try:
            write_parquet(target, " UNION ALL ".join(parts), sources)
        except OSError as error:
            failure = f"cannot write {target}: {error.strerror or error}"
        else:
            return target
    raise Refused(failure)
