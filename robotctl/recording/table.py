"""The messages of one topic as rows of values, written as CSV or as JSON lines."""

from __future__ import annotations

import csv
import json
import struct
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import isfinite
from typing import Any, Final, TextIO

from robotctl.base.errors import UnreadableFile, UsageError
from robotctl.base.unknown_name import unknown_name
from robotctl.kernel.constants import NS_PER_S
from robotctl.messages.definition import Definition, Field, UnreadableType, parse_definition
from robotctl.messages.fields import FieldPath, ValueKind
from robotctl.messages.values import Decoder
from robotctl.recording.read.messages import ALWAYS, Window
from robotctl.recording.read.reader import Recording, RecordingInfo, TopicInfo

_ENCODING = "cdr"


def choose_topic(info: RecordingInfo, name: str, type_name: str, *, listing: str) -> TopicInfo:
    """Return the topic `name` with the type `type_name` or, for "", any type.

    The leading / of `name` is optional. The error suggests `listing`, which lists the topics.

    Raises:
        UsageError: The recording has no such topic, or the topic has several types.
        UnreadableFile: The messages of the topic are not in CDR.
    """
    names = {each.name for each in info.topics}
    full_name = name if name in names else f"/{name}"
    if full_name not in names:
        cause, cure = unknown_name("topic", name, names)
        cure = cure if cure.startswith("did you mean") else f"see: {listing}"
        raise UsageError(f"{cause} in {info.path}", cure)
    found = _of_type([each for each in info.topics if each.name == full_name], type_name)
    if found.encoding != _ENCODING:
        raise UnreadableFile(
            f"{found.name} has messages in {found.encoding or 'no encoding'}, not in {_ENCODING}"
        )
    return found


def _of_type(found: Sequence[TopicInfo], wanted: str) -> TopicInfo:
    chosen = [each for each in found if wanted in ("", each.type_name)]
    if len(chosen) == 1:
        return chosen[0]
    types = ", ".join(each.type_name for each in found)
    raise UsageError(
        f"{found[0].name} has the types {types} there", f"choose one: --type {found[0].type_name}"
    )


Row = list[Any]

TIME_COLUMNS: Final = (
    FieldPath(("log_ns",), Field("log_ns", "int64")),
    FieldPath(("publish_ns",), Field("publish_ns", "int64")),
    FieldPath(("time_s",), Field("time_s", "float64")),
)
"""First columns: receipt, publication [ns since the epoch], receipt since the first message [s]."""

_DESCRIBED_IN: Final = "ros2msg"


class TopicTable:
    """The messages of a topic as rows. Each row begins with the values of TIME_COLUMNS."""

    def __init__(self, recording: Recording, topic: TopicInfo) -> None:
        """Prepare the columns. `recording` must stay open.

        Raises:
            UnreadableFile: The recording has no readable definition of the type.
        """
        self._recording = recording
        self.topic = topic
        self._start_ns = recording.info().start_ns
        self.definition = recorded_definition(topic)
        self._decoder = Decoder(self.definition)
        self.columns = (*TIME_COLUMNS, *map(_beside_times, self._decoder.columns))
        """The columns, in the order of the values of a row."""

    def rows(self, on_missing: Callable[[str], None], window: Window = ALWAYS) -> Iterator[Row]:
        """Yield the rows with a log time in `window` [ns], in the order of log time.

        `on_missing` gets a sentence about each part that cannot be read or decoded.
        """
        row_of, start_ns, type_name = self._decoder.row, self._start_ns, self.topic.type_name
        misfits, reason = 0, ""
        for message in self._recording.messages({self.topic.name}, on_missing, window):
            if message.type_name != type_name:
                continue
            try:
                values = row_of(message.data)
            except struct.error as error:
                misfits, reason = misfits + 1, reason or str(error)
                continue
            log_ns = message.log_ns
            yield [log_ns, message.publish_ns, (log_ns - start_ns) / NS_PER_S, *values]
        if misfits:
            on_missing(f"{misfits} messages of {self.topic.name} cannot be decoded: {reason}")


def recorded_definition(topic: TopicInfo) -> Definition:
    """Return the definition of a topic's message type.

    Raises:
        UnreadableFile: The definition is missing or cannot be read.
    """
    is_empty = topic.type_name.endswith("/Empty")
    if not topic.definition.strip() and not is_empty:
        raise UnreadableFile(f"the recording does not describe the type {topic.type_name}")
    if topic.schema_encoding not in (_DESCRIBED_IN, "") and not is_empty:
        raise UnreadableFile(
            f"the type {topic.type_name} is described in {topic.schema_encoding}, "
            f"not in {_DESCRIBED_IN}"
        )
    try:
        return parse_definition(topic.type_name, topic.definition)
    except UnreadableType as error:
        raise UnreadableFile(f"the type {topic.type_name} cannot be read: {error}") from None


def _beside_times(column: FieldPath) -> FieldPath:
    """Return `column`, with the prefix `message.` if a time column has its name."""
    if column.name in {each.name for each in TIME_COLUMNS}:
        return FieldPath(("message", *column.steps), column.field)
    return column


_Change = Callable[[Any], Any]

_BOTH: Final = "\r\n"
"""A row end for `csv` that makes it quote CR and LF in texts, also before Python 3.13."""


def write_csv(columns: Sequence[FieldPath], rows: Iterable[Row], stream: TextIO) -> int:
    """Write a header and the rows, and return the number of rows.

    Lines end with a line feed. Lists become JSON, bytes base64, NaN and infinity `nan` and `inf`.
    """
    writer = csv.writer(_LineFeeds(stream), lineterminator=_BOTH)
    writer.writerow([column.name for column in columns])
    return sum(bool(writer.writerow(row)) for row in _changed(columns, rows, json_of))


def write_json_lines(columns: Sequence[FieldPath], rows: Iterable[Row], stream: TextIO) -> int:
    """Write the rows as `json_lines` yields them, and return their number."""
    return sum(bool(stream.write(line)) for line in json_lines(columns, rows))


def json_lines(columns: Sequence[FieldPath], rows: Iterable[Row]) -> Iterator[str]:
    """Yield each row as an ASCII line with a JSON object by column name.

    Bytes become base64. NaN and infinity become the texts `NaN`, `Infinity` and `-Infinity`.
    """
    names = [column.name for column in columns]
    for row in _changed(columns, rows, lambda value: value):
        yield json_of(dict(zip(names, row, strict=True))) + "\n"


def json_of(value: Any) -> str:
    """Return `value` as JSON in one line. NaN and infinity become texts, bytes become base64."""
    try:
        return json.dumps(value, allow_nan=False)
    except (ValueError, TypeError):
        return json.dumps(_plain(value))


class _LineFeeds:
    """A stream for `csv` that replaces the end of each row by a line feed."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, row: str) -> int:
        return self._stream.write(f"{row.removesuffix(_BOTH)}\n")


def _changed(columns: Sequence[FieldPath], rows: Iterable[Row], of_list: _Change) -> Iterable[Row]:
    """Return the rows with bytes replaced by base64 text, and each list by `of_list(list)`."""
    changes = {ValueKind.BYTES: _base64, ValueKind.LIST: of_list, ValueKind.NESTED: of_list}
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
