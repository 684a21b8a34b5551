"""Convert a recording, in MCAP or sqlite3, to new MCAP files with the same messages."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryDirectory
from typing import Any, Final
from urllib.parse import quote

import yaml
from mcap.records import Attachment, Channel, Metadata, Schema

from robotctl.base.errors import UnreadableFile
from robotctl.base.files import open_regular
from robotctl.messages.installed import installed_type
from robotctl.recording.format.disk import DiskFile, atomic_output
from robotctl.recording.format.names import (
    CONVERSION_RECORD,
    LEDGER_RECORD,
    LIBRARY,
    PROFILE,
    Compression,
    natural_order,
)
from robotctl.recording.format.records import MAX_TIME_NS, PlainMessage
from robotctl.recording.format.rosbag2 import (
    METADATA_RECORD,
    BagFile,
    metadata_text,
    serialized_metadata,
    total_count_in,
    write_metadata,
)
from robotctl.recording.format.topics import Topic
from robotctl.recording.read.chunks import ZSTD, MessageDecompressor, message_compression
from robotctl.recording.read.file_index import OF_EACH_FILE, note_missing, topic_of
from robotctl.recording.read.files import (
    SQLITE_SUFFIX,
    SUFFIX,
    Progress,
    absent_files,
    each_with_progress,
    recording_files,
    unpack_zstd_file,
)
from robotctl.recording.read.messages import ReadableFile, batched, open_readable
from robotctl.recording.read.read_limits import Damaged, ReadLimits, Tally
from robotctl.recording.write.buffer import ChunkEncoder, pack
from robotctl.recording.write.mcap_writer import McapFile

_BATCH_BYTES: Final = 1 << 20
_PROGRESS_ROWS: Final = 1000
_MAX_TOPICS: Final = 1 << 16
"""Maximum number of topics: a channel id of MCAP has 16 bits."""

_TABLES: Final = (
    "SELECT count(*) FROM sqlite_master WHERE type='table' AND name IN ('messages', 'topics')"
)
"""Counts no views: a view with one of these names could have endless rows."""

_MESSAGES: Final = "SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"


class SqliteSource:
    """Reader of a .db3 file of rosbag2, with the interface of `ReadableFile`.

    A .db3 file has one time per message, which becomes both log time and publish time.
    """

    profile = PROFILE
    library = "rosbag2 (sqlite3)"

    def __init__(self, path: Path, content: Path, on_progress: Progress) -> None:
        """Open the database `content`, the file `path` of the bag or its decompressed content.

        `on_progress` gets the messages done and in total.

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
        """Return no metadata, as a .db3 file has no such records."""
        return ()

    def attachments(self) -> Iterator[Attachment]:
        """Yield no attachments, as a .db3 file has none."""
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
        """Return channel and schema of each topic, by the topic's id in the database."""
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
        """Return the message definitions in the database by type, {} for older bags."""
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
    """Return the URI that opens a database read-only."""
    # With `immutable` SQLite adds no files, but ignores a journal.
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
    return MessageDecompressor(0, ReadLimits.of(path.stat().st_size), Tally()).decompress


ConvertibleFile = ReadableFile | SqliteSource
"""One file of a recording, open for one pass. `lost` is complete after that pass."""


class Sources:
    """Iterable over the files of a recording, in MCAP or sqlite3.

    `lost` and `is_live` are complete after the iteration. `lost` has a sentence per unreadable
    file.
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
        """Message count in `metadata.yaml`; 0 if there is none, or `path` is one file."""

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
    """Return the sqlite3 files of a bag in their order, [] for a bag in MCAP."""
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


_NAMES: Final[Mapping[str, Mapping[int, str]]] = {
    "history": {0: "system_default", 1: "keep_last", 2: "keep_all"},
    "reliability": {0: "system_default", 1: "reliable", 2: "best_effort"},
    "durability": {0: "system_default", 1: "transient_local", 2: "volatile"},
    "liveliness": {0: "system_default", 1: "automatic", 3: "manual_by_topic"},
}
"""The known names by number in rmw_qos_*_policy_e (rmw/types.h)."""

_MAX_CHARACTERS: Final = 1 << 16
"""Longer texts are not parsed, as YAML is slow. 100 publishers take less."""


def named_policies(profiles: str) -> str:
    """Return a YAML list of QoS with names for policy numbers; other text is returned unchanged."""
    if len(profiles) > _MAX_CHARACTERS:
        return profiles
    try:
        found = yaml.safe_load(profiles)
    except (yaml.YAMLError, ValueError, RecursionError):
        return profiles
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        return profiles
    if not any(isinstance(each.get(policy), int) for each in found for policy in _NAMES):
        return profiles
    return yaml.safe_dump([_named(each) for each in found], sort_keys=False)


def _named(profile: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _NAMES[key].get(value, "unknown")
        if key in _NAMES and isinstance(value, int)
        else value
        for key, value in profile.items()
    }


_MAX_CHANNELS: Final = 1 << 16
"""Maximum number of channels: a channel id of MCAP has 16 bits."""

_QOS = "offered_qos_profiles"


class ChannelTable:
    """The channels of all source files. Equal channels get one id."""

    def __init__(self) -> None:
        self.channels: list[Channel] = []
        self.schemas: list[Schema] = []
        self.topics: list[Topic] = []
        """The topic entry in `metadata.yaml` for each channel, by channel id."""

        self._ids: dict[tuple[object, ...], int] = {}
        self._schema_ids: dict[tuple[object, ...], int] = {}

    def add(self, channel: Channel, schema: Schema | None) -> int:
        """Return the id of `channel`, added if new, or raise UnreadableFile if no id is left."""
        metadata = dict(channel.metadata)
        if _QOS in metadata:
            metadata[_QOS] = named_policies(metadata[_QOS])
        schema_id = 0 if schema is None else self._add_schema(schema)
        key = (channel.topic, channel.message_encoding, schema_id, tuple(sorted(metadata.items())))
        if key not in self._ids:
            number = self._ids[key] = len(self.channels)
            if number >= _MAX_CHANNELS:
                raise UnreadableFile(
                    f"its files have more than {_MAX_CHANNELS} topics", "convert them one by one"
                )
            added = replace(channel, id=number, schema_id=schema_id, metadata=metadata)
            self.channels.append(added)
            self.topics.append(topic_of(added, "" if schema is None else schema.name))
        return self._ids[key]

    def _add_schema(self, schema: Schema) -> int:
        key = (schema.name, schema.encoding, schema.data)
        if key not in self._schema_ids:
            self._schema_ids[key] = len(self.schemas) + 1
            self.schemas.append(replace(schema, id=self._schema_ids[key]))
        return self._schema_ids[key]


class OutputFile:
    """One file of the converted recording. Every method may raise OSError."""

    def __init__(
        self, path: Path, table: ChannelTable, compression: Compression, profile: str, origin: str
    ) -> None:
        """Create the file. `origin` names the program of the source."""
        self._path = path
        self._table = table
        self._storage = DiskFile(path)
        library = f"{LIBRARY}, converted from {origin}"
        self._mcap = McapFile(self._storage, profile=profile, library=library)
        self._encoder = ChunkEncoder(compression, 1)
        self._schemas = 0
        self._channels = 0

    def is_full(self, limit: int | None) -> bool:
        """Return whether a file with messages has reached `limit` bytes, False without a limit."""
        return limit is not None and bool(self._mcap.summary.counts) and self._mcap.size >= limit

    def write(self, messages: Sequence[PlainMessage]) -> None:
        """Write messages as one chunk."""
        self._announce()
        self._mcap.commit(self._encoder.encode(pack(messages)), finished=False)

    def add_metadata(self, records: Sequence[Metadata]) -> None:
        """Queue metadata records; the next write to the file includes them."""
        for record in records:
            self._mcap.add_metadata(record.name, record.metadata)

    def add_attachment(self, attachment: Attachment) -> None:
        """Write an attachment."""
        self._mcap.add_attachment(attachment)
        self._mcap.commit(finished=False)  # one at a time in memory

    def finish(self, ledger: Sequence[Metadata]) -> BagFile:
        """Complete and close the file, and return its entry in `metadata.yaml`."""
        self._announce()
        summary = self._mcap.summary
        described = BagFile(self._path.name, summary.start_ns, summary.end_ns, dict(summary.counts))
        text = serialized_metadata(self._table.topics, [described])
        self._mcap.add_metadata(METADATA_RECORD, {"serialized_metadata": text})
        self.add_metadata(ledger)
        self._mcap.commit()
        self.close()
        return described

    def close(self) -> None:
        """Close the file. Closing twice is harmless."""
        self._storage.close()

    def _announce(self) -> None:
        """Add the schemas and channels that the file lacks."""
        for schema in self._table.schemas[self._schemas :]:
            self._mcap.add_schema(schema)
        for channel in self._table.channels[self._channels :]:
            self._mcap.add_channel(channel)
        self._schemas, self._channels = len(self._table.schemas), len(self._table.channels)


_REWRITTEN: Final = (METADATA_RECORD, LEDGER_RECORD, CONVERSION_RECORD)


@dataclass(frozen=True, slots=True)
class Form:
    """The options of a conversion. By default, each source file becomes one file."""

    compression: Compression = Compression.ZSTD
    split_bytes: int | None = None
    """If not None, a new file begins at this size [bytes], not with each source file."""

    one_file: bool = False
    """Whether all source files become one file."""


@dataclass(slots=True)
class Converted:
    """The result of a conversion. `lost` has a sentence per unreadable part."""

    files: list[BagFile] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    attachment_count: int = 0
    is_live: bool = False
    """Whether the source was still being recorded: later messages are missing."""

    @property
    def message_count(self) -> int:
        """Messages in all files."""
        return sum(file.message_count for file in self.files)


class Converter:
    """Writes the source files, one after the other, into the files of a new recording."""

    def __init__(self, name_of: Callable[[int], Path], form: Form) -> None:
        """`name_of` gets the number of an output file, from 0, and returns its path."""
        self._name_of = name_of
        self._form = form
        self.table = ChannelTable()
        self._output: OutputFile | None = None
        self._ledger: list[Metadata] = []
        self._begun = 0
        self._sources: list[str] = []
        self.done = Converted()

    def run(self, sources: Iterable[ConvertibleFile]) -> Converted:
        """Convert the source files in the given order, and return the result.

        Raises:
            OSError: The disk is full or fails.
        """
        try:
            for source in sources:
                self._convert(source)
            self._finish()
        finally:
            if self._output is not None:
                with suppress(OSError):
                    self._output.close()
        return self.done

    def _convert(self, source: ConvertibleFile) -> None:
        ids = {channel.id: self.table.add(channel, schema) for channel, schema in source.channels()}
        output = self._file_for(source)
        self._ledger = []
        for messages in source.batches():
            if output.is_full(self._form.split_bytes):
                self._finish()
                output = self._begin(source)
            output.write([(ids[channel], *rest) for channel, *rest in messages])  # type: ignore[misc]
        for attachment in source.attachments():
            output.add_attachment(attachment)
            self.done.attachment_count += 1
        kept = [each for each in source.metadata() if each.name not in _REWRITTEN]
        output.add_metadata([each for each in kept if each.name not in OF_EACH_FILE])
        self._ledger = [each for each in source.metadata() if each.name == LEDGER_RECORD][-1:]
        self.done.lost += (f"{source.name}: {sentence}" for sentence in source.lost)

    def _file_for(self, source: ConvertibleFile) -> OutputFile:
        """Return the output file in which `source` begins: the current one, or else a new one."""
        output = self._output
        if output is None:
            return self._begin(source)
        if self._form.one_file or (
            self._form.split_bytes and not output.is_full(self._form.split_bytes)
        ):
            self._sources.append(source.name)
            return output
        self._finish()
        return self._begin(source)

    def _begin(self, source: ConvertibleFile) -> OutputFile:
        path = self._name_of(self._begun)
        self._begun += 1
        self._output = OutputFile(
            path, self.table, self._form.compression, source.profile, source.library
        )
        self._sources = [source.name]
        latest = {each.name: each for each in source.metadata() if each.name in OF_EACH_FILE}
        self._output.add_metadata(list(latest.values()))
        return self._output

    def _finish(self) -> None:
        if self._output is None:
            return
        about = {"of": ", ".join(self._sources), "lost": "\n".join(self.done.lost)}
        self._output.add_metadata([Metadata(name=CONVERSION_RECORD, metadata=about)])
        self.done.files.append(self._output.finish(self._ledger))
        self._output, self._ledger = None, []


MCAP_SUFFIX = ".mcap"


def convert(
    source: Path, target: Path, form: Form, on_progress: Progress = lambda done, total: None
) -> Converted:
    """Convert the recording `source` to `target`, a file if named `*.mcap`, else a folder.

    Raises:
        UnreadableFile: Nothing can be read, or there are over _MAX_CHANNELS channels.
        Refused: `target` exists or cannot be written; nothing new remains.
    """
    sources = Sources(source, on_progress)
    with atomic_output(target, source) as unfinished:
        if target.suffix == MCAP_SUFFIX:
            converter = Converter(lambda number: unfinished, form)
        else:
            unfinished.mkdir()
            converter = Converter(
                lambda number: unfinished / f"{target.name}_{number}{MCAP_SUFFIX}", form
            )
        done = converter.run(sources)
        lost = [*sources.lost, *done.lost]
        if not lost and sources.told_messages > done.message_count:
            note_missing(
                lost,
                f"metadata.yaml counts {sources.told_messages} messages, "
                f"and {done.message_count} are there",
            )
        if not done.message_count and lost:
            raise UnreadableFile(f"{source} holds no readable message: {'; '.join(lost)}")
        if unfinished.is_dir():
            write_metadata(unfinished, converter.table.topics, done.files)
    done.lost, done.is_live = lost, sources.is_live
    return done
