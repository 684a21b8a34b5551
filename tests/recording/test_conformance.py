"""Files are read as the MCAP specification says, with any optional record left out.

Bags that rosbag2 itself wrote can be opened, complete or truncated.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Flag, auto
from itertools import combinations
from pathlib import Path
from shutil import copyfile, copytree
from typing import Final

import pytest
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    Schema,
    Statistics,
)
from mcap.records import Message as MessageRecord
from mcap.writer import CompressionType, IndexType, Writer

from robotctl.recording import Message, Recording, read_info, read_messages
from robotctl.recording.format.records import MAGIC, record_bytes
from robotctl.recording.keep.recover import recover
from robotctl.recording.read.messages import open_readable
from tests.recording.mcap_files import CHANNEL, DATA_START, chunk, finished
from tests.support.bags import SAMPLES, needs_samples
from tests.support.recordings import salvaged

Content = MessageRecord | Attachment | Metadata
_PADDING: Final = b"\x01\xff\xff"
PADDED: Final = {*McapRecord.__subclasses__()} - {Chunk, DataEnd, Footer, MessageRecord}
"""Not those whose last field fills the rest, or whose length is fixed."""

SCHEMA: Final = Schema(id=1, name="Example", encoding="c", data=b"\x04\x05\x06")
EXAMPLE: Final = Channel(1, "example", "a", {"foo": "bar"}, 1)
SCHEMALESS: Final = Channel(1, "example", "a", {"foo": "bar"}, 0)


class Feature(Flag):
    """An optional part of a file."""

    CHUNKS = auto()
    MESSAGE_INDEX = auto()
    STATISTICS = auto()
    REPEATED_SCHEMAS = auto()
    REPEATED_CHANNELS = auto()
    ATTACHMENT_INDEX = auto()
    METADATA_INDEX = auto()
    CHUNK_INDEX = auto()
    SUMMARY_OFFSETS = auto()
    EXTRA_DATA = auto()


INDEXES: Final = {
    Feature.MESSAGE_INDEX: IndexType.MESSAGE,
    Feature.CHUNK_INDEX: IndexType.CHUNK,
    Feature.ATTACHMENT_INDEX: IndexType.ATTACHMENT,
    Feature.METADATA_INDEX: IndexType.METADATA,
}

CONTENTS: Final[dict[str, tuple[Channel | None, tuple[Content, ...]]]] = {
    "NoData": (None, ()),
    "OneMessage": (EXAMPLE, (MessageRecord(1, 2, b"\1\2\3", 1, 10),)),
    "OneAttachment": (None, (Attachment(1, 2, "myFile", "application/octet-stream", b"\1\2\3"),)),
    "OneMetadata": (None, (Metadata("myMetadata", {"foo": "bar"}),)),
    "OneSchemalessMessage": (SCHEMALESS, (MessageRecord(1, 2, b"\1\2\3", 1, 10),)),
    "TenMessages": (EXAMPLE, tuple(MessageRecord(1, n, bytes([n]), 1, n) for n in range(10))),
}


@dataclass(frozen=True, slots=True)
class Variant:
    """One file of the suite."""

    content: str
    features: Feature

    @property
    def name(self) -> str:
        """The name of the file in the public suite."""
        return "-".join([self.content, *(feature.name or "" for feature in self.features)])

    @property
    def messages(self) -> list[MessageRecord]:
        """Return the messages that a reader must find."""
        return [each for each in CONTENTS[self.content][1] if isinstance(each, MessageRecord)]

    def write(self, path: Path) -> Path:
        """Write the file by the writer of the mcap package."""
        indexes = IndexType.NONE
        for feature, kind in INDEXES.items():
            indexes |= kind if feature in self.features else IndexType.NONE
        with path.open("wb") as stream, pytest.MonkeyPatch.context() as patch:
            for record in PADDED if Feature.EXTRA_DATA in self.features else ():
                patch.setattr(record, "write", _padded(record.write))
            writer = Writer(
                stream,
                compression=CompressionType.NONE,
                index_types=indexes,
                repeat_channels=Feature.REPEATED_CHANNELS in self.features,
                repeat_schemas=Feature.REPEATED_SCHEMAS in self.features,
                use_chunking=Feature.CHUNKS in self.features,
                use_statistics=Feature.STATISTICS in self.features,
                use_summary_offsets=Feature.SUMMARY_OFFSETS in self.features,
                enable_data_crcs=True,
            )
            writer.start(library="")
            channel, records = CONTENTS[self.content]
            if channel is not None:
                if channel.schema_id:
                    writer.register_schema(SCHEMA.name, SCHEMA.encoding, SCHEMA.data)
                told = channel.topic, channel.message_encoding, channel.schema_id
                writer.register_channel(*told, channel.metadata)
            for each in records:
                if isinstance(each, MessageRecord):
                    times = each.log_time, each.data, each.publish_time
                    writer.add_message(each.channel_id, *times, each.sequence)
                elif isinstance(each, Attachment):
                    about = each.name, each.media_type, each.data
                    writer.add_attachment(each.create_time, each.log_time, *about)
                else:
                    writer.add_metadata(each.name, each.metadata)
            writer.finish()
        return path


def _padded(write: Callable[..., None]) -> Callable[[McapRecord, RecordBuilder], None]:
    """Return what writes a record with bytes at its end that no field has."""

    def write_padded(record: McapRecord, stream: RecordBuilder) -> None:
        plain = RecordBuilder()
        write(record, plain)
        data = plain.end()
        length = (len(data) - 9 + len(_PADDING)).to_bytes(8, "little")
        stream.write(data[:1] + length + data[9:] + _PADDING)

    return write_padded


def variants() -> Iterator[Variant]:
    """Yield every file of the suite, without features that have no effect in it."""
    for content, (channel, records) in CONTENTS.items():
        meaningful = _meaningful(channel, records)
        for number in range(len(meaningful) + 1):
            for chosen in combinations(meaningful, number):
                features = Feature(0)
                for feature in chosen:
                    features |= feature
                needs_chunks = Feature.MESSAGE_INDEX | Feature.CHUNK_INDEX
                if Feature.CHUNKS in features or not features & needs_chunks:
                    yield Variant(content, features)


def _meaningful(channel: Channel | None, records: tuple[Content, ...]) -> list[Feature]:
    found = [Feature.STATISTICS, Feature.SUMMARY_OFFSETS, Feature.EXTRA_DATA]
    if channel is not None:
        found += [Feature.CHUNKS, Feature.MESSAGE_INDEX, Feature.CHUNK_INDEX]
        found.append(Feature.REPEATED_CHANNELS)
        if channel.schema_id:
            found.append(Feature.REPEATED_SCHEMAS)
    if any(isinstance(each, Attachment) for each in records):
        found.append(Feature.ATTACHMENT_INDEX)
    if any(isinstance(each, Metadata) for each in records):
        found.append(Feature.METADATA_INDEX)
    return found


VARIANTS = list(variants())
READINGS: dict[str, Callable[[Recording, Callable[[str], None]], list[Message]]] = {
    "by log time": lambda recording, miss: list(recording.messages(None, miss)),
    "as written": lambda recording, miss: list(recording.in_order_written(None, miss)),
}


def test_the_suite_is_whole() -> None:
    """No file is made twice, and every content is there."""
    assert {variant.content for variant in VARIANTS} == set(CONTENTS)
    assert len({variant.name for variant in VARIANTS}) == len(VARIANTS) > 400


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("indexed", [True, False], ids=["whole", "without its end"])
def test_every_variant_is_read_whole(tmp_path: Path, content: str, indexed: bool) -> None:
    for variant in (each for each in VARIANTS if each.content == content):
        path = variant.write(tmp_path / "file.mcap")
        if not indexed:
            path.write_bytes(path.read_bytes()[: -len(MAGIC)])
        assert_read(path, variant, whole=indexed)


def mixed_up(path: Path, *, attachments: int = 0) -> Path:
    """Return a complete file with messages, metadata and attachments between its chunks."""
    parts = [
        CHANNEL,
        chunk(message(1)),
        message(2) + message(3),
        record_bytes(Metadata("notes", {"author": "somebody"})),
        chunk(message(4)),
        *[record_bytes(Attachment(1, 2, "picture", "image/png", b"123"))] * attachments,
        message(5),
    ]
    offset, entries = DATA_START, []
    for part in parts:
        if part[0] == Opcode.CHUNK:
            stored = len(part) - 9 - 28 - 4 - len("zstd") - 8
            entries.append(
                ChunkIndex(len(part), offset, "zstd", stored, 1, 0, {}, 0, len(message(1)))
            )
        offset += len(part)
    statistics = Statistics(attachments, 1, {1: 5}, 2, 5, 5, 1, 1, 0)
    path.write_bytes(finished(b"".join(parts), [CHANNEL, *map(record_bytes, entries)], statistics))
    return path


def message(number: int) -> bytes:
    return record_bytes(MessageRecord(1, number, bytes([number]), 0, number))


@pytest.mark.parametrize("attachments", [0, 1])
def test_what_stands_between_the_chunks_is_read_as_well(tmp_path: Path, attachments: int) -> None:
    path = mixed_up(tmp_path / "mixed.mcap", attachments=attachments)
    info = read_info(path)
    assert (info.message_count, info.missing, info.indexed) == (5, (), True)
    assert info.metadata == {"notes": {"author": "somebody"}}
    for read in READINGS.values():
        missing: list[str] = []
        with Recording(path) as recording:
            assert [m.data[0] for m in read(recording, missing.append)] == [1, 2, 3, 4, 5]
        assert missing == []
    salvage = recover(path, tmp_path / "out.mcap")
    assert (salvage.message_count, salvage.attachment_count, salvage.lost) == (5, attachments, ())


def test_what_the_summary_counts_and_nobody_finds_is_missing(tmp_path: Path) -> None:
    path = mixed_up(tmp_path / "mixed.mcap")
    data = path.read_bytes()
    at = data.index(record_bytes(Metadata("notes", {"author": "somebody"})))
    path.write_bytes(data[:at] + b"\x80" + data[at + 1 :])  # a private record
    assert read_info(path).missing == ("its summary counts 1 metadata records, and 0 are there",)
    assert recover(path, tmp_path / "out.mcap").lost == read_info(path).missing


def assert_read(path: Path, variant: Variant, *, whole: bool) -> None:
    """Check that info, messages, metadata and attachments are those that were written."""
    _, records = CONTENTS[variant.content]
    expected = [
        (each.data, each.log_time, each.publish_time, each.sequence) for each in variant.messages
    ]
    info = read_info(path)
    assert info.message_count == len(expected), variant.name
    assert not (whole and info.missing), (variant.name, info.missing)
    for name, read in READINGS.items():
        missing: list[str] = []
        with Recording(path) as recording:
            found = read(recording, missing.append)
        assert [(m.data, m.log_ns, m.publish_ns, m.sequence) for m in found] == expected, name
        assert missing == [], (variant.name, missing)
        assert {m.topic for m in found} <= {"example"}
    metadata = {each.name: each.metadata for each in records if isinstance(each, Metadata)}
    assert info.metadata == metadata, variant.name
    attachments = [each for each in records if isinstance(each, Attachment)]
    with open_readable(path, "", lambda done, total: None) as file:
        assert list(file.attachments()) == attachments
    target = path.with_name("out.mcap")
    salvage = recover(path, target) if whole or records else None
    if salvage is not None:
        counts = salvage.message_count, salvage.attachment_count
        assert counts == (len(expected), len(attachments)), variant.name
        assert not (whole and salvage.lost), (variant.name, salvage.lost)
    target.unlink(missing_ok=True)


@needs_samples
def test_a_file_that_rosbag2_names_and_that_is_not_there_is_missing(tmp_path: Path) -> None:
    copytree(SAMPLES / "split_bag", tmp_path / "bag", copy_function=copyfile)
    (tmp_path / "bag").chmod(0o755)
    (tmp_path / "bag" / "wbag_3.mcap").unlink()
    info = read_info(tmp_path / "bag")
    assert info.missing == ("wbag_3.mcap: metadata.yaml names it, but it is not there",)


@needs_samples
@pytest.mark.parametrize(
    ("name", "count", "topics"),
    [
        ("talker", 20, {"/rosout", "/parameter_events", "/topic"}),
        ("split_bag", 6074, {letter * 3 for letter in "ABCDEFGH"}),
        (
            "bag_with_topics_and_service_events",
            10,
            {
                "/test_topic1",
                "/test_topic2",
                "/test_service1/_service_event",
                "/test_service2/_service_event",
                "/events/write_split",
            },
        ),
        ("cdr_test", 7, {"/test_topic", "/array_topic"}),
    ],
)
def test_bags_of_rosbag2_open(name: str, count: int, topics: set[str]) -> None:
    info = read_info(SAMPLES / name)
    assert (info.message_count, info.missing, info.profile) == (count, (), "ros2")
    assert {topic.name for topic in info.topics} <= topics
    assert {topic.name for topic in info.topics if topic.message_count} <= topics
    messages = list(read_messages(SAMPLES / name))
    assert len(messages) == count
    times = [message.log_ns for message in messages]
    assert times == sorted(times)
    assert (times[0], times[-1]) == (info.start_ns, info.end_ns)


@needs_samples
def test_truncated_bags_of_rosbag2_give_true_messages(tmp_path: Path) -> None:
    dice = random.Random(9)
    for source in sorted(SAMPLES.glob("*/*.mcap")):
        whole = [(m.topic, m.data, m.log_ns) for m in read_messages(source)]
        data = source.read_bytes()
        path = tmp_path / "cut.mcap"
        for cut in dice.choices(range(200, len(data)), k=40):
            path.write_bytes(data[:cut])
            messages, missing = salvaged(path)
            assert {(m.topic, m.data, m.log_ns) for m in messages} <= set(whole)
            assert missing or len(messages) == len(whole)
