"""Damage costs only the damaged part and is reported; no data is made up."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Header,
    Metadata,
    Schema,
    Statistics,
)
from mcap.writer import CompressionType

from robotctl.errors import UnreadableFile
from robotctl.recording import Compression, read_info, read_messages
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.mcap_input import parse
from robotctl.testing.faults import mutated, record_boundaries
from tests.support.recordings import (
    first_numbers,
    foreign,
    number_of,
    recorded,
    salvaged,
)


@pytest.mark.parametrize("summary", [True, False])
def test_one_damaged_chunk_costs_that_chunk_only(tmp_path: Path, summary: bool) -> None:
    path = recorded(tmp_path / "run", 1000)
    data = bytearray(path.read_bytes())
    chunks = [offset for offset in record_boundaries(bytes(data)) if data[offset] == Opcode.CHUNK]
    data[chunks[10] + 80] ^= 0xFF
    path.write_bytes(data if summary else data[:-40])
    messages, missing = salvaged(path)
    lost = set(range(1, 1001)) - {number_of(m.data) for m in messages}
    per_chunk = 1024 // 83
    assert lost == set(range(10 * per_chunk + 1, 11 * per_chunk + 1))
    assert len(missing) == (1 if summary else 3)
    if not summary:
        assert missing[-1] == "run_0.mcap: metadata.yaml counts 1000 messages, and 988 are there"


@pytest.mark.parametrize("write", [recorded, lambda path, n: foreign(path.with_suffix(".m"), n)])
@pytest.mark.parametrize("garbage", [bytes(500), b"\x06" * 500, b"\xff" * 500])
def test_after_a_piece_of_nonsense_the_next_chunk_is_found(
    tmp_path: Path, write: Callable[[Path, int], Path], garbage: bytes
) -> None:
    path = write(tmp_path / "run", 1000)
    whole = path.read_bytes()
    chunks = [offset for offset in record_boundaries(whole) if whole[offset] == Opcode.CHUNK]
    data = bytearray(whole[:-30])
    data[chunks[10] : chunks[10] + 500] = garbage
    path.write_bytes(data)
    messages, missing = salvaged(path)
    numbers = [number_of(m.data) for m in messages]
    assert 960 < len(numbers) < 1000
    assert numbers == sorted(set(numbers))
    assert f"bytes {chunks[10]} to" in missing[0]


def test_nonsense_without_end_is_searched_in_bounded_time(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", 100)
    head = b"\x06" + bytes(12)
    path.write_bytes(path.read_bytes()[:3000] + head * 500_000)
    messages, missing = salvaged(path)
    assert 0 < len(messages) < 100
    assert missing


def test_our_own_files_hold_no_messages_outside_chunks(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", 300)
    data = bytearray(path.read_bytes())
    for offset in record_boundaries(path.read_bytes()):
        if data[offset] == Opcode.MESSAGE_INDEX:
            data[offset] = Opcode.MESSAGE
    path.write_bytes(data[:-30])
    messages, missing = salvaged(path)
    assert [number_of(m.data) for m in messages] == list(range(1, 301))
    assert missing


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        (
            Schema,
            struct.pack("<H", 1) + b"\1\0\0\0a" + b"\1\0\0\0b" + struct.pack("<I", 99) + b"abc",
        ),
        (Channel, struct.pack("<HH", 1, 1) + b"\1\0\0\0a" + b"\1\0\0\0b" + b"\x09\0\0\0"),
        (Metadata, b"\xff\xff\xff\xffname"),
        (Statistics, b"\0" * 20),
        (Header, b"\1\0\0\0\xff" + b"\0\0\0\0"),
        (ChunkIndex, b"\xff" * 60),
    ],
)
def test_a_record_that_promises_more_than_it_holds_is_damaged(kind: Any, content: bytes) -> None:
    with pytest.raises(Damaged, match="record is malformed"):
        parse(kind, content)


def test_what_is_missing_is_said_in_few_words(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", 2000)
    whole = path.read_bytes()
    data = bytearray(whole)
    for offset in record_boundaries(whole):
        if whole[offset] == Opcode.CHUNK:
            data[offset + 80] ^= 0xFF
    for content in (data, data[:-30]):
        path.write_bytes(content)
        messages, missing = salvaged(path)
        assert messages == []
        assert len(read_info(path).missing) <= 21
        with pytest.raises(UnreadableFile, match="and more") as caught:
            list(read_messages(path))
        assert len(str(caught.value)) < 3000
    assert missing


def test_messages_without_a_described_channel_are_counted_as_missing(tmp_path: Path) -> None:
    data = recorded(tmp_path / "run", 24).read_bytes()
    boundaries = list(record_boundaries(data))
    channel = next(offset for offset in boundaries if data[offset] == Opcode.CHANNEL)
    end = boundaries[boundaries.index(channel) + 1]
    data_end = next(offset for offset in boundaries if data[offset] == Opcode.DATA_END)
    path = tmp_path / "bad.mcap"
    path.write_bytes(data[:channel] + data[end:data_end])
    info = read_info(path)
    assert info.message_count == 0
    assert "24 messages are lost: no record describes their channel" in info.missing


def test_fuzzed_files_give_one_error_or_true_messages(tmp_path: Path) -> None:
    fuzz(tmp_path, 1000)


@pytest.mark.slow
def test_ten_thousand_fuzzed_files_give_one_error_or_true_messages(tmp_path: Path) -> None:
    fuzz(tmp_path, 10_000)


def fuzz(folder: Path, rounds: int) -> None:
    dice = random.Random(8)
    files = [
        recorded(folder / "zstd", 300, compression=Compression.ZSTD).read_bytes(),
        recorded(folder / "none", 300, compression=Compression.NONE).read_bytes(),
        foreign(folder / "zstd.mcap", 300).read_bytes(),
        foreign(folder / "lz4.mcap", 300, compression=CompressionType.LZ4).read_bytes(),
    ]
    true = set(first_numbers(300))
    path = folder / "fuzzed.mcap"
    refusals: list[str] = []
    for _ in range(rounds):
        path.write_bytes(mutated(dice.choice(files), dice))
        try:
            info = read_info(path)
            messages, missing = salvaged(path)
        except UnreadableFile as error:
            refusals.append(str(error))
            continue
        assert {message.data for message in messages} <= true
        assert len(messages) >= 300 or missing or info.missing
    assert len(refusals) < rounds // 2
    assert not any("\n" in refusal for refusal in refusals)
