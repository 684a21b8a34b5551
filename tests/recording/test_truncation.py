"""A truncated file gives all messages before the cut, and reports that more are missing."""

from __future__ import annotations

import random
import struct
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from robotctl.errors import UnreadableFile
from robotctl.recording import Compression, read_info
from robotctl.recording.format.records import MAGIC, MESSAGE_HEAD
from robotctl.testing.faults import record_boundaries
from tests.support.recordings import first_numbers, foreign, recorded, salvaged


def complete_prefix(data: bytes, length: int) -> int:
    """Return how many messages are in the chunks within the first `length` bytes."""
    count = 0
    for offset in record_boundaries(data):
        opcode, size = struct.unpack_from("<BQ", data, offset)
        if opcode == Opcode.MESSAGE_INDEX:
            continue
        if offset + 9 + size > length or opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            uncompressed, _, name = struct.unpack_from("<QII", data, offset + 9 + 16)
            count += uncompressed // (MESSAGE_HEAD.size + 52)
            assert name in (0, 3, 4)
    return count


def cuts(data: bytes, dice: random.Random) -> list[int]:
    at_records = {offset + shift for offset in record_boundaries(data) for shift in (-1, 0, 1)}
    return sorted(at_records | set(dice.choices(range(len(data)), k=300)))


@pytest.mark.parametrize("compression", list(Compression))
def test_a_truncated_file_gives_its_full_prefix(tmp_path: Path, compression: Compression) -> None:
    data = recorded(tmp_path / "run", 300, compression=compression).read_bytes()
    header_end = list(record_boundaries(data))[1]
    path = tmp_path / "cut.mcap"
    for cut in cuts(data, random.Random(5)):
        path.write_bytes(data[:cut])
        if cut < header_end:
            with pytest.raises(UnreadableFile):
                read_info(path)
            continue
        messages, missing = salvaged(path)
        assert [m.data for m in messages] == first_numbers(complete_prefix(data, cut)), cut
        info = read_info(path)
        assert info.message_count == len(messages)
        assert bool(missing) == (cut < len(data) - len(MAGIC)), cut
        assert list(info.missing) == missing


@pytest.mark.slow
def test_a_file_truncated_at_each_of_its_last_64_kib_gives_its_full_prefix(tmp_path: Path) -> None:
    options = {"compression": Compression.NONE, "chunk_bytes": 4096}
    data = recorded(tmp_path / "run", 800, **options).read_bytes()
    path = tmp_path / "cut.mcap"
    for cut in range(len(data) - (64 << 10), len(data)):
        path.write_bytes(data[:cut])
        messages, _ = salvaged(path)
        assert [m.data for m in messages] == first_numbers(complete_prefix(data, cut)), cut


def test_a_cut_chunk_of_a_writer_that_only_appends_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = foreign(tmp_path / "cut.mcap", 1000, compression=CompressionType.NONE, chunk_size=10**9)
    data = path.read_bytes()
    for cut in random.Random(6).choices(range(2000, 80_000), k=50):
        path.write_bytes(data[:cut])
        messages, missing = salvaged(path)
        assert len(messages) in range((cut - 400) // 83, cut // 83 + 1)
        assert [m.data for m in messages] == first_numbers(len(messages))
        assert missing


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_cut_compressed_chunk_is_read_as_far_as_it_unpacks(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = tmp_path / "cut.mcap"
    dice = random.Random(7)
    sent = [dice.randbytes(1000) for _ in range(2000)]
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=10**9, compression=compression)
        writer.start()
        channel = writer.register_channel("/a", "cdr", 0)
        for number, data in enumerate(sent):
            writer.add_message(channel, number, data, number)
        writer.finish()
    path.write_bytes(path.read_bytes()[:1_000_000])
    messages, missing = salvaged(path)
    assert len(messages) > (500 if compression is CompressionType.ZSTD else -1)
    assert [m.data for m in messages] == sent[: len(messages)]
    assert missing
