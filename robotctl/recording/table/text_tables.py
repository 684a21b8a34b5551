"""Tables as text: CSV, and one JSON object a line."""

from __future__ import annotations

import csv
import json
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import isfinite
from typing import Any, Final, TextIO

from robotctl.messages.fields import Column, ColumnKind
from robotctl.recording.table.topic_table import Row

_Change = Callable[[Any], Any]

_BOTH: Final = "\r\n"
"""The end of a row for csv, which before Python 3.13 puts a text with one of these characters in
quotes only if rows end with it; to a reader both end a row."""


def write_csv(columns: Sequence[Column], rows: Iterable[Row], stream: TextIO) -> int:
    """Write a header and the rows; return their number.

    Lines end with a line feed. Lists are JSON, bytes are base64, and NaN and infinity `nan`, `inf`.
    """
    writer = csv.writer(_LineFeeds(stream), lineterminator=_BOTH)
    writer.writerow([column.name for column in columns])
    counted = _Counted(_changed(columns, rows, json_of))
    writer.writerows(counted)
    return counted.count


def write_json_lines(columns: Sequence[Column], rows: Iterable[Row], stream: TextIO) -> int:
    """Write an object for each row, with the names of the columns as keys; return their number.

    Bytes are base64, and what JSON has no number for is the text `NaN`, `Infinity`, `-Infinity`.
    """
    names = [column.name for column in columns]
    counted = _Counted(_changed(columns, rows, lambda value: value))
    stream.writelines(json_of(dict(zip(names, row, strict=True))) + "\n" for row in counted)
    return counted.count


def json_of(value: Any) -> str:
    """Return JSON in one line; numbers that it lacks become texts, and bytes become base64."""
    try:
        return json.dumps(value, allow_nan=False)
    except (ValueError, TypeError):
        return json.dumps(_plain(value))


class _LineFeeds:
    """Receives the rows of csv, and ends them with a line feed alone."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, row: str) -> int:
        return self._stream.write(f"{row.removesuffix(_BOTH)}\n")


class _Counted:
    """Counts what it yields."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._rows = rows
        self.count = 0

    def __iter__(self) -> Iterator[Row]:
        for row in self._rows:
            self.count += 1
            yield row


def _changed(columns: Sequence[Column], rows: Iterable[Row], of_list: _Change) -> Iterable[Row]:
    """Return the rows with text in place of bytes, and what `of_list` makes of lists."""
    changes = {ColumnKind.BYTES: _base64, ColumnKind.LIST: of_list, ColumnKind.NESTED: of_list}
    places = [
        (place, changes[column.kind])
        for place, column in enumerate(columns)
        if column.kind in changes
    ]
    return _with_changes(rows, places) if places else rows


def _with_changes(rows: Iterable[Row], places: Sequence[tuple[int, _Change]]) -> Iterator[Row]:
    for row in rows:
        for place, change in places:
            row[place] = change(row[place])
        yield row


def _base64(value: bytes) -> str:
    return b64encode(value).decode()


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not isfinite(value):
        return "NaN" if value != value else "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, dict):
        return {name: _plain(inner) for name, inner in value.items()}
    if isinstance(value, bytes):
        return _base64(value)
    return [_plain(inner) for inner in value] if isinstance(value, list) else value
