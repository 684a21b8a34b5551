"""Generates the conformance suite of the MCAP format, with the variants of the public suite.

Each combination of optional parts that a writer may leave out, with each kind of content.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Flag, auto
from itertools import combinations
from typing import Final

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from robotctl.recording.format.records import MAGIC, record_bytes

Content = Message | Attachment | Metadata
_PADDING: Final = b"\x01\xff\xff"
_UNPADDED: Final = (Opcode.MESSAGE, Opcode.FOOTER, Opcode.DATA_END)
"""Records that cannot be padded: their last field fills the rest, or their length is fixed."""

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


CONTENTS: Final[dict[str, tuple[Channel | None, tuple[Content, ...]]]] = {
    "NoData": (None, ()),
    "OneMessage": (EXAMPLE, (Message(1, 2, b"\1\2\3", 1, 10),)),
    "OneAttachment": (None, (Attachment(1, 2, "myFile", "application/octet-stream", b"\1\2\3"),)),
    "OneMetadata": (None, (Metadata("myMetadata", {"foo": "bar"}),)),
    "OneSchemalessMessage": (SCHEMALESS, (Message(1, 2, b"\1\2\3", 1, 10),)),
    "TenMessages": (EXAMPLE, tuple(Message(1, n, bytes([n]), 1, n) for n in range(10))),
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
    def messages(self) -> list[Message]:
        """Return the messages that a reader must find."""
        return [each for each in CONTENTS[self.content][1] if isinstance(each, Message)]

    def encoded(self) -> bytes:
        """Return the file."""
        return _Writer(self).file()


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


class _Writer:
    def __init__(self, variant: Variant) -> None:
        self._features = variant.features
        self._channel, self._records = CONTENTS[variant.content]
        self._data = bytearray(MAGIC)
        self._summary: dict[Opcode, bytes] = {}

    def file(self) -> bytes:
        """Return the whole file."""
        self._data += self._record(Opcode.HEADER, Header("", ""))
        definitions = b""
        if self._channel is not None:
            if self._channel.schema_id:
                definitions += self._record(Opcode.SCHEMA, SCHEMA)
            definitions += self._record(Opcode.CHANNEL, self._channel)
        messages = [each for each in self._records if isinstance(each, Message)]
        loose = b"".join(self._record(Opcode.MESSAGE, each) for each in messages)
        if Feature.CHUNKS in self._features:
            self._chunk(definitions, messages)
        else:
            self._data += definitions + loose
        for record in self._records:
            self._other(record)
        self._data += self._record(Opcode.DATA_END, DataEnd(crc32(bytes(self._data))))
        return bytes(self._data) + self._end(messages)

    def _record(self, opcode: Opcode, record: McapRecord) -> bytes:
        data = record_bytes(record)
        if Feature.EXTRA_DATA not in self._features or opcode in _UNPADDED:
            return data
        length = (len(data) - 9 + len(_PADDING)).to_bytes(8, "little")
        return data[:1] + length + data[9:] + _PADDING

    def _index(self, opcode: Opcode, record: McapRecord) -> None:
        self._summary[opcode] = self._summary.get(opcode, b"") + self._record(opcode, record)

    def _chunk(self, definitions: bytes, messages: list[Message]) -> None:
        records, places = definitions, []
        for message in messages:
            places.append((message.log_time, len(records)))
            records += self._record(Opcode.MESSAGE, message)
        times = [message.log_time for message in messages]
        start = len(self._data)
        head = struct.pack("<QQQII", min(times), max(times), len(records), crc32(records), 0)
        content = head + struct.pack("<Q", len(records)) + records
        self._data += struct.pack("<BQ", Opcode.CHUNK, len(content)) + content
        length = len(self._data) - start
        offsets: dict[int, int] = {}
        if Feature.MESSAGE_INDEX in self._features:
            offsets[1] = len(self._data)
            self._data += self._record(Opcode.MESSAGE_INDEX, MessageIndex(1, places))
        if Feature.CHUNK_INDEX in self._features:
            index_length = len(self._data) - start - length
            self._index(
                Opcode.CHUNK_INDEX,
                ChunkIndex(
                    chunk_length=length,
                    chunk_start_offset=start,
                    compression="",
                    compressed_size=len(records),
                    message_end_time=max(times),
                    message_index_length=index_length,
                    message_index_offsets=offsets,
                    message_start_time=min(times),
                    uncompressed_size=len(records),
                ),
            )

    def _other(self, record: Content) -> None:
        offset = len(self._data)
        if isinstance(record, Attachment):
            self._data += self._record(Opcode.ATTACHMENT, record)
            if Feature.ATTACHMENT_INDEX in self._features:
                self._index(
                    Opcode.ATTACHMENT_INDEX,
                    AttachmentIndex(
                        offset,
                        len(self._data) - offset,
                        record.create_time,
                        record.log_time,
                        len(record.data),
                        record.name,
                        record.media_type,
                    ),
                )
        elif isinstance(record, Metadata):
            self._data += self._record(Opcode.METADATA, record)
            if Feature.METADATA_INDEX in self._features:
                length = len(self._data) - offset
                self._index(Opcode.METADATA_INDEX, MetadataIndex(offset, length, record.name))

    def _end(self, messages: list[Message]) -> bytes:
        """Return summary, summary offsets, footer and magic."""
        if Feature.REPEATED_SCHEMAS in self._features:
            self._index(Opcode.SCHEMA, SCHEMA)
        if Feature.REPEATED_CHANNELS in self._features and self._channel is not None:
            self._index(Opcode.CHANNEL, self._channel)
        if Feature.STATISTICS in self._features:
            self._index(Opcode.STATISTICS, self._statistics(messages))
        begin = len(self._data)
        body, offsets = b"", b""
        for opcode, group in self._summary.items():
            offset = SummaryOffset(opcode, begin + len(body), len(group))
            offsets += self._record(Opcode.SUMMARY_OFFSET, offset)
            body += group
        if Feature.SUMMARY_OFFSETS not in self._features:
            offsets = b""
        footer = record_bytes(Footer(begin if body else 0, begin + len(body) if offsets else 0, 0))[
            :-4
        ]
        return (
            body + offsets + footer + crc32(body + offsets + footer).to_bytes(4, "little") + MAGIC
        )

    def _statistics(self, messages: list[Message]) -> Statistics:
        times = [message.log_time for message in messages]
        return Statistics(
            attachment_count=sum(isinstance(each, Attachment) for each in self._records),
            channel_count=int(self._channel is not None),
            channel_message_counts={1: len(messages)} if messages else {},
            chunk_count=int(Feature.CHUNKS in self._features),
            message_count=len(messages),
            message_end_time=max(times, default=0),
            message_start_time=min(times, default=0),
            metadata_count=sum(isinstance(each, Metadata) for each in self._records),
            schema_count=int(self._channel is not None and bool(self._channel.schema_id)),
        )
