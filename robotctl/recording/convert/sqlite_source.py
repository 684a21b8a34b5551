"""The files of rosbag2's sqlite3 storage, to be converted."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final
from urllib.parse import quote

from mcap.records import Attachment, Channel, Metadata, Schema

from robotctl.recording.convert.installed_definition import installed_definition
from robotctl.recording.format.names import PROFILE
from robotctl.recording.format.records import MAX_TIME_NS, PlainMessage
from robotctl.recording.read.compressed_messages import (
    ZSTD,
    MessageDecompressor,
    message_compression,
)
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.read_limits import ReadLimits
from robotctl.recording.read.read_tally import ReadTally

_BATCH_BYTES: Final = 1 << 20
_MAX_TOPICS: Final = 1 << 16
"""A channel id of MCAP has 16 bits."""

_TABLES: Final = (
    "SELECT count(*) FROM sqlite_master WHERE type='table' AND name IN ('messages', 'topics')"
)
"""A view of these names could have rows without end."""

_MESSAGES: Final = "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"


class SqliteSource:
    """A .db3 file (see `ConvertibleFile`).

    sqlite3 has one time for each message: it becomes log time and publish time.
    """

    profile = PROFILE
    library = "rosbag2 (sqlite3)"

    def __init__(self, path: Path, content: Path, on_progress: Callable[[float], None]) -> None:
        """Open the database in the file `content`, of the file `path` in the bag.

        `on_progress` gets the part of the messages that is done, from 0 to 1.

        Raises:
            Damaged: It is not such a database, or cannot be read.
        """
        self.name = path.name
        self.lost: list[str] = []
        self._on_progress = on_progress
        self._unpack = _decompression(path)
        try:
            self._database = sqlite3.connect(_address(content), uri=True)
            self._database.row_factory = sqlite3.Row
            if self._number(_TABLES) != 2:
                raise Damaged("it is no bag of rosbag2: it has no tables of topics and messages")
            self._count = self._number("SELECT max(id) FROM messages")
            self._channels = self._read_channels()
        except sqlite3.Error as error:
            raise Damaged(f"it is no bag of rosbag2 that sqlite3 can read: {error}") from error

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def channels(self) -> Sequence[tuple[Channel, Schema | None]]:
        """Return a channel for each topic."""
        return list(self._channels.values())

    def metadata(self) -> Sequence[Metadata]:
        """Return nothing: there are no such records in sqlite3."""
        return ()

    def attachments(self) -> Iterator[Attachment]:
        """Yield nothing: there are no attachments in sqlite3."""
        return iter(())

    def batches(self) -> Iterator[Sequence[PlainMessage]]:
        """Yield the messages in the order of their time, about 1 MB together."""
        batch: list[PlainMessage] = []
        size = done = odd = 0
        try:
            for row in self._database.execute(_MESSAGES):
                done += 1
                message = self._message(row)
                if message is None:
                    odd += 1
                    continue
                batch.append(message)
                size += len(message[1])
                if size >= _BATCH_BYTES:
                    yield batch
                    batch, size = [], 0
                    self._on_progress(done / max(self._count, done))
        except sqlite3.Error as error:
            self.lost.append(f"the database is damaged after {done} messages: {error}")
        if batch:
            yield batch
        if odd:
            self.lost.append(f"{odd} messages have no valid topic, time or data")

    def _message(self, row: sqlite3.Row) -> PlainMessage | None:
        number, time_ns, data = row
        known = self._channels.get(number)
        if known is None or not isinstance(data, bytes) or not isinstance(time_ns, int):
            return None
        if not 0 <= time_ns <= MAX_TIME_NS:
            return None
        try:
            return known[0].id, self._unpack(data), time_ns, time_ns, 0
        except Damaged:
            return None

    def _read_channels(self) -> dict[object, tuple[Channel, Schema | None]]:
        """Return channel and schema of each topic, by its id in the database."""
        definitions = self._definitions()
        channels: dict[object, tuple[Channel, Schema | None]] = {}
        for row in self._database.execute("SELECT * FROM topics"):
            topic = dict(zip(row.keys(), row, strict=True))
            name, type_name = topic.get("name"), topic.get("type")
            if not isinstance(name, str) or not isinstance(type_name, str):
                self.lost.append("a topic without name or type")
                continue
            if len(channels) >= _MAX_TOPICS:
                raise Damaged(f"it has more than {_MAX_TOPICS} topics")
            type_hash = str(topic.get("type_description_hash") or "")
            text = definitions.get(type_name) or installed_definition(type_name, type_hash)
            schema = Schema(
                id=len(channels) + 1,
                name=type_name,
                encoding="ros2msg" if text else "",
                data=text.encode(errors="replace"),
            )
            channel = Channel(
                id=len(channels),
                topic=name,
                message_encoding=str(topic.get("serialization_format") or "cdr"),
                schema_id=schema.id,
                metadata={
                    "topic_type_hash": type_hash,
                    "offered_qos_profiles": str(topic.get("offered_qos_profiles") or ""),
                },
            )
            channels[topic["id"]] = channel, schema
        return channels

    def _definitions(self) -> dict[str, str]:
        """Return the definitions that newer bags hold, by type."""
        if not self._number("SELECT count(*) FROM sqlite_master WHERE name='message_definitions'"):
            return {}
        return {
            str(row["topic_type"]): str(row["encoded_message_definition"])
            for row in self._database.execute(
                "SELECT * FROM message_definitions WHERE encoding='ros2msg'"
            )
        }

    def _number(self, query: str) -> int:
        (found,) = self._database.execute(query).fetchone()
        return found if isinstance(found, int) else 0


def _address(path: Path) -> str:
    """Return the URI under which nothing is written beside the file, unless it has a journal."""
    plain = f"file:{quote(str(path.absolute()))}?mode=ro"
    has_journal = any(path.with_name(path.name + end).exists() for end in ("-wal", "-journal"))
    return plain if has_journal else f"{plain}&immutable=1"


def _decompression(path: Path) -> Callable[[bytes], bytes]:
    """Return what makes a message of the bytes in the database.

    Raises:
        Damaged: They are compressed in an unknown way.
    """
    form = message_compression((), path)
    if not form:
        return bytes
    if form != ZSTD:
        raise Damaged(f"its messages are compressed as {form}, which cannot be read")
    limits = ReadLimits.of(path.stat().st_size)
    return MessageDecompressor(0, limits, ReadTally()).decompress
