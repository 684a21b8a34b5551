"""The messages of one topic as rows."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from robotctl.base.errors import UnreadableFile, UsageError
from robotctl.base.unknown_name import unknown_name
from robotctl.kernel.units import NS_PER_S
from robotctl.messages.definition import Definition, UnreadableType, parse_definition
from robotctl.messages.fields import Column, ColumnKind, FlatDecoder
from robotctl.recording.read.info import RecordingInfo, TopicInfo
from robotctl.recording.read.messages import ALWAYS, Window
from robotctl.recording.read.reader import Recording

_ENCODING = "cdr"


def choose_topic(info: RecordingInfo, name: str, type_name: str, *, listing: str) -> TopicInfo:
    """Return the topic `name`, whose leading / may be left out; "" takes any `type_name`.

    `listing` is the command that lists the topics.

    Raises:
        UsageError: The recording has no such topic, or it has several types.
        UnreadableFile: Its messages are not in CDR.
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
    Column("log_ns", ColumnKind.NUMBER, "int64"),
    Column("publish_ns", ColumnKind.NUMBER, "int64"),
    Column("time_s", ColumnKind.NUMBER, "float64"),
)
"""The first columns of each table: when a message was received and published [ns since the epoch],
and the seconds from the first message of the recording to its reception."""

_DESCRIBED_IN: Final = "ros2msg"


class TopicTable:
    """The rows of a topic; times of the recording come first in each."""

    def __init__(self, recording: Recording, topic: TopicInfo) -> None:
        """Plan the columns.

        Raises:
            UnreadableFile: The recording does not describe the type so that it can be read.
        """
        self._recording = recording
        self.topic = topic
        self._start_ns = recording.info().start_ns
        self.definition = _definition(topic)
        try:
            self._decoder = FlatDecoder(self.definition)
        except UnreadableType as error:
            raise _unreadable(topic, error) from None
        self.columns = (*TIME_COLUMNS, *map(_beside_times, self._decoder.columns))
        """The columns, in the order of the values of a row."""

    def rows(self, on_missing: Callable[[str], None], window: Window = ALWAYS) -> Iterator[Row]:
        """Yield the rows in the order of their log time [ns], those in `window` (both included).

        `on_missing` gets a sentence about each part that cannot be read, and at the end one about
        the messages that do not fit their type.
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


def _definition(topic: TopicInfo) -> Definition:
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
        raise _unreadable(topic, error) from None


def _unreadable(topic: TopicInfo, error: UnreadableType) -> UnreadableFile:
    return UnreadableFile(f"the type {topic.type_name} cannot be read: {error}")


def _beside_times(column: Column) -> Column:
    """Return the column of a field with another name, if that is the name of a time."""
    if column.name in {each.name for each in TIME_COLUMNS}:
        return Column(f"message.{column.name}", column.kind, column.type_name)
    return column
