"""Files of a megabyte that take minutes or gigabytes to read for a reader without limits."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from itertools import count, repeat
from pathlib import Path
from typing import Final

import lz4.frame
import zstandard
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
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from robotctl.cdr.known_types import JOURNAL_ENTRY
from robotctl.recording.format.journal import TOPIC, EntryKind, JournalEntry, encode
from robotctl.recording.format.metadata_names import LIBRARY
from robotctl.recording.format.records import MAGIC, MESSAGE_HEAD, record_bytes
from robotctl.testing.drives import BEGIN_NS, drive

SIZE: Final = 1_000_000
_HEAD: Final = struct.Struct("<BQ")
_MIB: Final = 1 << 20

CHANNEL: Final = record_bytes(Channel(1, "/bomb", "cdr", {}, 0))


def chunk(records: bytes, compression: str = "zstd", level: int = 19) -> bytes:
    """Return a chunk record without a checksum."""
    stored = _zstd(records, level) if compression == "zstd" else lz4.frame.compress(records)
    return stored_chunk(stored, compression, len(records))


def stored_chunk(stored: bytes, compression: str, size: int) -> bytes:
    """Return a chunk record that claims to unpack to `size` bytes."""
    name = compression.encode()
    content = struct.pack("<QQQII", 0, 1, size, 0, len(name)) + name
    content += struct.pack("<Q", len(stored)) + stored
    return _HEAD.pack(Opcode.CHUNK, len(content)) + content


def _zstd(records: bytes, level: int) -> bytes:
    return zstandard.ZstdCompressor(level=level).compress(records)


def messages(number: int, size: int = 0) -> bytes:
    """Return `count` equal messages."""
    head = MESSAGE_HEAD.pack(Opcode.MESSAGE, 22 + size, 1, 0, 1, 1)
    return (head + bytes(size)) * number


def repeated(record: bytes, size: int = SIZE) -> bytes:
    """Return the record as many times as fit into `size` bytes."""
    return record * max(size // len(record), 1)


def begun(data: bytes, library: str = "somebody") -> bytes:
    """Return a file that was not finished and must be scanned."""
    return MAGIC + record_bytes(Header("", library)) + CHANNEL + data


def finished(
    data: bytes, summary: Iterable[bytes], statistics: Statistics, *, library: str = "somebody"
) -> bytes:
    """Return a file with a summary."""
    start = MAGIC + record_bytes(Header("", library)) + data + record_bytes(DataEnd(0))
    body = b"".join(summary) + record_bytes(statistics)
    footer = record_bytes(Footer(len(start), 0, 0))[:-4]
    crc = crc32(footer, crc32(body)).to_bytes(4, "little")
    return start + body + footer + crc + MAGIC


def counted(
    messages: int = 0, chunks: int = 0, metadata: int = 0, attachments: int = 0
) -> Statistics:
    """Return statistics that count messages of one channel."""
    counts = {1: messages} if messages else {}
    return Statistics(attachments, 1, counts, chunks, messages, 1, 0, metadata, 0)


def indexed(chunk_record: bytes, chunks: int, claimed: int, size: int) -> bytes:
    """Return `count` chunks, and a summary that claims a total number of messages."""
    entries = []
    offset = len(MAGIC) + len(record_bytes(Header("", "somebody")))
    length = len(chunk_record)
    stored = length - 9 - 28 - 4 - 4 - 8
    for number in range(chunks):
        at = offset + number * length
        entries.append(record_bytes(ChunkIndex(length, at, "zstd", stored, 1, 0, {}, 0, size)))
    return finished(chunk_record * chunks, [CHANNEL, *entries], counted(claimed, chunks))


def _zeros(mib: int) -> bytes:
    return bytes(mib * _MIB)


def _nested_candidates() -> bytes:
    """Return a file in which each chunk header claims all bytes that follow, 64 MiB unpacked."""
    inner = b""
    blocks = b"".join(
        struct.pack("<I", 3 | (1 << 1) | (131_071 << 3))[:3] + b"\0" for _ in range(8)
    )
    while len(inner) < 100_000:
        raw = struct.pack("<I", (len(inner) << 3))[:3] + inner if len(inner) < 131_000 else b""
        frame = b"\x28\xb5\x2f\xfd\x00\x58" + raw + blocks + struct.pack("<I", 1)[:3]
        inner = b"\xff" + stored_chunk(frame, "zstd", 64 * _MIB)
    return inner


def _one_metadata_many_times() -> bytes:
    header = len(MAGIC) + len(record_bytes(Header("", "somebody")))
    record = record_bytes(Metadata("m", {"k": "v" * (SIZE // 2)}))
    index = record_bytes(MetadataIndex(header, len(record), "m"))
    times = SIZE // 2 // len(index)
    return finished(record, [index] * times, counted(metadata=times))


def _metadata_within_metadata() -> bytes:
    """Return a file in which a record begins every 100 bytes and claims all bytes that follow."""
    header = len(MAGIC) + len(record_bytes(Header("", "somebody")))
    body = bytearray(b"x" * (SIZE // 2))
    indexes = []
    for offset in range(0, len(body) - 1000, 100):
        rest = len(body) - offset
        claim = _HEAD.pack(Opcode.METADATA, rest - 9) + struct.pack("<II", 0, rest - 9 - 8)
        body[offset : offset + 25] = claim + struct.pack("<II", rest, 0)[:8]
        indexes.append(record_bytes(MetadataIndex(header + offset, rest, "")))
    return finished(bytes(body), indexes, counted(metadata=len(indexes)))


def _attachments_within_attachments() -> bytes:
    header = len(MAGIC) + len(record_bytes(Header("", "somebody")))
    body = bytearray(SIZE // 2)
    indexes = []
    for offset in range(0, len(body) - 1000, 100):
        length = len(body) - offset - 9
        fields = struct.pack("<QQIIQ", 0, 0, 0, 0, length - 36)
        body[offset : offset + 9 + len(fields)] = _HEAD.pack(Opcode.ATTACHMENT, length) + fields
        indexes.append(record_bytes(AttachmentIndex(header + offset, length, 0, 0, 0, "a", "b")))
    return finished(bytes(body), indexes, counted(attachments=len(indexes)))


def _one_schema_for_all() -> bytes:
    definition = b"x" * (SIZE // 2)
    schema = record_bytes(Schema(id=1, name="a/B", encoding="ros2msg", data=definition))
    channels = [record_bytes(Channel(n, f"/{n}", "cdr", {}, 1)) for n in range(1, SIZE // 2 // 33)]
    return finished(b"", [schema, *channels], Statistics(0, len(channels), {}, 0, 0, 0, 0, 0, 1))


def _channels_without_end() -> bytes:
    channels = [record_bytes(Channel(n, f"/{n}", "", {}, 0)) for n in range(1, SIZE // 33)]
    return finished(b"", channels, Statistics(0, len(channels), {}, 0, 0, 0, 0, 0, 0))


def _one_attachment_many_times() -> bytes:
    header = len(MAGIC) + len(record_bytes(Header("", "somebody")))
    record = record_bytes(Attachment(0, 0, "a", "b", bytes(SIZE // 2)))
    index = record_bytes(AttachmentIndex(header, len(record), 0, 0, 0, "a", "b"))
    times = SIZE // 2 // len(index)
    return finished(record, [index] * times, counted(attachments=times))


def spaces_in_metadata() -> str:
    """Return a `metadata.yaml` in which each known key has spaces as its value."""
    spaces = " " * (SIZE // 4)
    keys = ("compression_mode:", "compression_format:", "- path:", "  message_count:")
    return "".join(f"{key}{spaces}!\n" for key in keys)


def _journal(entries: Iterable[JournalEntry]) -> bytes:
    """Return a recording with as many journal entries as fit into SIZE."""
    schema = record_bytes(Schema(id=1, name=JOURNAL_ENTRY, encoding="ros2msg", data=b""))
    channel = record_bytes(Channel(1, f"/{TOPIC}", "cdr", {}, 1))
    data = bytearray(schema + channel)
    waiting = bytearray()
    for entry in entries:
        serialized = encode(entry)
        waiting += MESSAGE_HEAD.pack(
            Opcode.MESSAGE, 22 + len(serialized), 1, 0, entry.t_ns, entry.t_ns
        )
        waiting += serialized
        if len(waiting) >= 4 * _MIB:
            data += chunk(bytes(waiting), level=3)
            waiting.clear()
            if len(data) >= SIZE:
                break
    else:
        data += chunk(bytes(waiting), level=3)
    return begun(bytes(data), LIBRARY)


def _numbered(kind: EntryKind, name: str, texts: Iterable[str]) -> Iterator[JournalEntry]:
    first = next(each for each in drive(0.1) if isinstance(each, JournalEntry))
    yield first._replace(seq=0)
    for seq, text in enumerate(texts, 1):
        yield JournalEntry(seq, first.t_ns + seq, kind, name, text)


def _ticks() -> Iterator[JournalEntry]:
    begin = BEGIN_NS
    texts = (f'{{"t_ns":{begin + seq}}}' for seq in count(1))
    return _numbered(EntryKind.EVENT, "Tick", texts)


def _snapshots() -> Iterator[JournalEntry]:
    first = next(each for each in drive(0.1) if isinstance(each, JournalEntry))
    return _numbered(EntryKind.SNAPSHOT, first.name, repeat(first.data))


def _long_texts() -> Iterator[JournalEntry]:
    long = "x" * 250_000
    texts = (
        f'{{"t_ns":{BEGIN_NS + seq},"request":{seq},"requested":0,"source":"{long}"}}'
        for seq in count(1)
    )
    return _numbered(EntryKind.EVENT, "ModeRequested", texts)


BOMBS: Final[dict[str, Callable[[], bytes]]] = {
    "zeros in large chunks": lambda: begun(repeated(chunk(_zeros(64)))),
    "zeros in small chunks": lambda: begun(repeated(chunk(_zeros(8)))),
    "zeros by lz4": lambda: begun(repeated(chunk(_zeros(16), "lz4"))),
    "empty messages": lambda: begun(repeated(chunk(messages(250_000)))),
    "empty messages, indexed": lambda: indexed(chunk(messages(250_000)), 800, 100, 31 * 250_000),
    "empty messages, counted": lambda: indexed(
        chunk(messages(250_000)), 800, 200_000_000, 31 * 250_000
    ),
    "large messages": lambda: begun(repeated(chunk(messages(1, 64 * _MIB)))),
    "messages of 24 MB": lambda: begun(repeated(chunk(messages(1, 24_000_000)))),
    "large messages, indexed": lambda: indexed(
        chunk(messages(1, 64 * _MIB)), 100, 100, 31 + 64 * _MIB
    ),
    "private records": lambda: begun(repeated(chunk(_HEAD.pack(0x80, 0) * 800_000))),
    "loose private records": lambda: begun(repeated(_HEAD.pack(0x80, 0))),
    "chunks within chunks": lambda: begun(_nested_candidates()),
    "one metadata record many times": _one_metadata_many_times,
    "metadata within metadata": _metadata_within_metadata,
    "attachments within attachments": _attachments_within_attachments,
    "one schema for all": _one_schema_for_all,
    "small metadata": lambda: begun(repeated(record_bytes(Metadata("", {})))),
    "metadata of empty values": lambda: begun(
        struct.pack("<BQII", Opcode.METADATA, 8 + 8 * 120_000, 0, 8 * 120_000) + bytes(8 * 120_000)
    ),
    "spaces in the text of a bag": lambda: begun(
        record_bytes(Metadata("rosbag2", {"serialized_metadata": spaces_in_metadata()}))
    ),
    "channels without end": _channels_without_end,
    "one attachment many times": _one_attachment_many_times,
    "journal of ticks": lambda: _journal(_ticks()),
    "journal of snapshots": lambda: _journal(_snapshots()),
    "journal of long texts": lambda: _journal(_long_texts()),
}
"""Name -> the function that makes the file."""


def write_bomb(path: Path, name: str) -> Path:
    """Write one of the BOMBS."""
    path.write_bytes(BOMBS[name]())
    return path
