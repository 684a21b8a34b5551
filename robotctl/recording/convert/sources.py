"""Opens the files of a recording for conversion, one after the other."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryDirectory
from typing import Final
from urllib.parse import quote

from mcap.records import Attachment, Channel, Metadata, Schema

from robotctl.base.files import open_regular
from robotctl.messages.installed import installed_type
from robotctl.recording.format.names import PROFILE, natural_order
from robotctl.recording.format.records import MAX_TIME_NS, PlainMessage
from robotctl.recording.format.rosbag2 import metadata_text, total_count_in
from robotctl.recording.read.chunks import ZSTD, MessageDecompressor, message_compression
from robotctl.recording.read.files import (
    SQLITE_SUFFIX,
    Progress,
    absent_files,
    each_with_progress,
    recording_files,
)
from robotctl.recording.read.messages import ReadableFile, batched, open_readable
from robotctl.recording.read.read_limits import Damaged, ReadLimits, Tally
from robotctl.recording.read.source import SUFFIX, unpack_zstd_file

_BATCH_BYTES: Final = 1 << 20
_PROGRESS_ROWS: Final = 1000
_MAX_TOPICS: Final = 1 << 16
"""A channel id of MCAP has 16 bits."""

_TABLES: Final = (
    "SELECT count(*) FROM sqlite_master WHERE type='table' AND name IN ('messages', 'topics')"
)
"""Counts only tables, because a view with one of these names could have endless rows."""

_MESSAGES: Final = "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"


class SqliteSource:
    """A .db3 file, with the attributes of `ReadableFile`.

    The file has one time for each message, which becomes both log time and publish time.
    """

    profile = PROFILE
    library = "rosbag2 (sqlite3)"

    def __init__(self, path: Path, content: Path, on_progress: Progress) -> None:
        """Open the database `content`: the file `path` of the bag, or its decompressed content.

        `on_progress` is called with the messages done, and in total.

        Raises:
            Damaged: `content` is not a database of rosbag2, or cannot be read.
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
        """Return nothing: a .db3 file has no metadata records."""
        return ()

    def attachments(self) -> Iterator[Attachment]:
        """Yield nothing: a .db3 file has no attachments."""
        return iter(())

    def batches(self) -> Iterator[Sequence[PlainMessage]]:
        """Yield the messages in order of their time, in batches of about 1 MB."""
        yield from batched(self._messages(), _BATCH_BYTES)

    def _messages(self) -> Iterator[PlainMessage]:
        done = odd = 0
        try:
            for row in self._database.execute(_MESSAGES):
                done += 1
                if message := self._message(row):
                    yield message
                else:
                    odd += 1
                if done % _PROGRESS_ROWS == 0:
                    self._on_progress(done, max(self._count, done))
        except sqlite3.Error as error:
            self.lost.append(f"the database is damaged after {done} messages: {error}")
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
            text = definitions.get(type_name, "")
            installed = installed_type(type_name)
            if not text and type_hash in ("", installed.type_hash):
                text = installed.text
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
        """Return the definitions in the database, by type; older bags have none."""
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
    """Return the URI of a database. Unless it has a journal, sqlite3 creates no file beside it."""
    plain = f"file:{quote(str(path.absolute()))}?mode=ro"
    has_journal = any(path.with_name(path.name + end).exists() for end in ("-wal", "-journal"))
    return plain if has_journal else f"{plain}&immutable=1"


def _decompression(path: Path) -> Callable[[bytes], bytes]:
    """Return the function that decompresses a message from the database.

    Raises:
        Damaged: The compression is unknown.
    """
    form = message_compression((), path)
    if not form:
        return bytes
    if form != ZSTD:
        raise Damaged(f"its messages are compressed as {form}, which cannot be read")
    limits = ReadLimits.of(path.stat().st_size)
    return MessageDecompressor(0, limits, Tally()).decompress


ConvertibleFile = ReadableFile | SqliteSource
"""One file of a recording, open for one pass: messages, then attachments. `lost` is complete after
it; each batch of messages is written as one chunk."""


class Sources:
    """The files of the recording `path`, in MCAP or sqlite3.

    `lost` and `is_live` are complete after the iteration; `lost` has a sentence about each file
    that is missing or cannot be opened.
    """

    def __init__(self, path: Path, on_progress: Progress) -> None:
        """Find the files.

        Raises:
            UnreadableFile: There are none, or `path` is not a recording.
        """
        text = metadata_text(path)
        self._paths = _sqlite_files(path) or recording_files(path)
        is_whole = self._paths != [path]
        self.lost = absent_files(text, self._paths) if is_whole else []
        self.told_messages = total_count_in(text) if is_whole else 0
        """Message count in `metadata.yaml`; 0 if it has none, or `path` is one file."""

        self.is_live = False
        """Whether a file was still being recorded when it was read."""

        self._text = text
        self._on_progress = on_progress

    def __iter__(self) -> Iterator[ConvertibleFile]:
        """Yield each file. A file stays open until the next one is requested."""
        for path, tell in each_with_progress(self._paths, self._on_progress):
            try:
                if _is_sqlite(path):
                    yield from _open_sqlite(path, tell)
                    continue
                with open_readable(path, self._text, tell) as file:
                    self.is_live |= file.file.is_changing()
                    yield file
            except Damaged as damage:
                self.lost.append(f"{path.name}: {damage}")
            except OSError as error:
                self.lost.append(f"{path.name}: {error.strerror or error}")


def _open_sqlite(path: Path, tell: Progress) -> Iterator[SqliteSource]:
    with open_regular(path) as file, TemporaryDirectory() as folder:
        content = path
        if path.name.endswith(SUFFIX):
            content = Path(folder) / path.stem
            unpacked = unpack_zstd_file(file.fileno(), lambda done, total: None)
            with open(unpacked, "rb") as plain, content.open("wb") as named:
                plain.seek(0)
                copyfileobj(plain, named)  # sqlite3 opens a file by its name
        with closing(SqliteSource(path, content, tell)) as source:
            yield source


def _sqlite_files(path: Path) -> list[Path]:
    """Return the sqlite3 files of a bag, in their order; none if it is in MCAP."""
    try:
        if not path.is_dir():
            return [path] if _is_sqlite(path) else []
        files = [each for each in path.iterdir() if _is_sqlite(each)]
        is_mcap = any(path.glob("*.mcap*"))
    except OSError:
        return []
    names = {each.name for each in files}
    unpacked = [each for each in files if each.name.removesuffix(SUFFIX) not in names - {each.name}]
    return [] if is_mcap else sorted(unpacked, key=natural_order)


def _is_sqlite(path: Path) -> bool:
    return path.name.endswith((SQLITE_SUFFIX, SQLITE_SUFFIX + SUFFIX))
