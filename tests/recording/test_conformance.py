"""Files are read as the MCAP specification says, with any optional record left out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.records import Attachment, ChunkIndex, Header, Metadata, Statistics
from mcap.records import Message as MessageRecord
from mcap.stream_reader import StreamReader

from robotctl.recording import Message, Recording, read_info
from robotctl.recording.format.records import MAGIC, record_bytes
from robotctl.recording.keep.recover import recover
from robotctl.recording.read.file_index import read_attachment
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.mcap_input import InputFile
from tests.support.mcap_bombs import CHANNEL, chunk, finished
from tests.support.mcap_conformance import CONTENTS, Feature, Variant, variants

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
def test_somebody_elses_reader_finds_the_suite_valid(tmp_path: Path, content: str) -> None:
    for variant in (each for each in VARIANTS if each.content == content):
        if Feature.CHUNKS | Feature.EXTRA_DATA in variant.features:
            continue  # the package cannot skip extra data in a chunk
        path = written(tmp_path, variant)
        with path.open("rb") as stream:
            found = [type(record).__name__ for record in StreamReader(stream).records]
        assert found.count("Message") == len(variant.messages), variant.name


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("indexed", [True, False], ids=["whole", "without its end"])
def test_every_variant_is_read_whole(tmp_path: Path, content: str, indexed: bool) -> None:
    for variant in (each for each in VARIANTS if each.content == content):
        path = written(tmp_path, variant)
        if not indexed:
            path.write_bytes(path.read_bytes()[: -len(MAGIC)])
        assert_read(path, variant, whole=indexed)


def mixed_up(path: Path, *, attachments: int = 0) -> Path:
    """Return a complete file with messages, metadata and attachments between its chunks.

    The summary lists the chunks, and counts everything.
    """
    header = len(MAGIC) + len(record_bytes(Header("", "somebody")))
    parts = [
        CHANNEL,
        chunk(message(1)),
        message(2) + message(3),
        record_bytes(Metadata("notes", {"author": "somebody"})),
        chunk(message(4)),
        *[record_bytes(Attachment(1, 2, "picture", "image/png", b"123"))] * attachments,
        message(5),
    ]
    offset, entries = header, []
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


def written(folder: Path, variant: Variant) -> Path:
    path = folder / "file.mcap"
    path.write_bytes(variant.encoded())
    return path


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
    with InputFile(path) as file:
        index = index_of(file)
        assert [read_attachment(file, offset) for offset in index.attachments] == attachments
    target = path.with_name("out.mcap")
    salvage = recover(path, target) if whole or records else None
    if salvage is not None:
        assert (salvage.message_count, salvage.attachment_count) == (
            len(expected),
            len(attachments),
        ), variant.name
        assert not (whole and salvage.lost), (variant.name, salvage.lost)
    target.unlink(missing_ok=True)
