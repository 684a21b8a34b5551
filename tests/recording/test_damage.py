"""Damage costs only the damaged part and is reported; no data is made up.

A truncated file gives all messages before the cut, and reports that more are missing.
Data that a power cut replaced by zeros is reported by every command, and counts as a loss.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Header, Metadata, Schema, Statistics
from mcap.writer import CompressionType

from robotctl.base.errors import UnreadableFile
from robotctl.recording import Compression, Recording, read_info, read_messages
from robotctl.recording.format.records import MAGIC, MESSAGE_HEAD
from robotctl.recording.keep.clip import Moment, cut_clip
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.read.messages import ALWAYS
from robotctl.recording.read.read_limits import Damaged
from robotctl.recording.read.records import parse
from robotctl.testing.faults import PAGE, chunks_of, mutated, record_boundaries, zero
from tests.support.cases import for_each
from tests.support.recordings import (
    by_mcap,
    first_numbers,
    flip,
    foreign,
    number_of,
    overwrite,
    read_strictly,
    recorded,
    salvaged,
)


@pytest.mark.parametrize("summary", [True, False])
def test_one_damaged_chunk_costs_that_chunk_only(tmp_path: Path, summary: bool) -> None:
    path = recorded(tmp_path / "run", 1000)
    flip(path, chunks_of(path.read_bytes())[10][0] + 80)
    if not summary:
        path.write_bytes(path.read_bytes()[:-40])
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
    start, _ = chunks_of(path.read_bytes())[10]
    path.write_bytes(path.read_bytes()[:-30])
    overwrite(path, start, garbage)
    messages, missing = salvaged(path)
    numbers = [number_of(m.data) for m in messages]
    assert 960 < len(numbers) < 1000
    assert numbers == sorted(set(numbers))
    assert f"bytes {start} to" in missing[0]


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


@for_each(
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
    for start, _ in chunks_of(path.read_bytes()):
        flip(path, start + 80)
    for end in (None, -30):
        path.write_bytes(path.read_bytes()[:end])
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
    fuzz(tmp_path, 250)


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
    at_records = [offset + shift for offset in record_boundaries(data) for shift in (-1, 0, 1)]
    return sorted({*dice.sample(at_records, 60), *dice.choices(range(len(data)), k=30)})


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
    numbered_data = [("/a", number, data) for number, data in enumerate(sent)]
    by_mcap(path, numbered_data, chunk_size=10**9, compression=compression)
    path.write_bytes(path.read_bytes()[:1_000_000])
    messages, missing = salvaged(path)
    assert len(messages) > (500 if compression is CompressionType.ZSTD else -1)
    assert [m.data for m in messages] == sent[: len(messages)]
    assert missing


COUNT = 1000

WRITERS: dict[str, Callable[[Path], Path]] = {
    "ours, zstd": lambda path: recorded(path / "run", COUNT),
    "ours, stored": lambda path: recorded(path / "run", COUNT, compression=Compression.NONE),
    "theirs, zstd": lambda path: foreign(path / "a.mcap", COUNT),
    "theirs, stored": lambda path: foreign(
        path / "a.mcap", COUNT, compression=CompressionType.NONE
    ),
    "theirs, stored, without checksums": lambda path: foreign(
        path / "a.mcap", COUNT, compression=CompressionType.NONE, enable_crcs=False
    ),
}


def assert_loss_is_named(path: Path, folder: Path) -> None:
    """Check that every command reports the loss, and that the messages read are right."""
    messages, missing = salvaged(path)
    assert 0 < len(messages) < COUNT
    assert [message.data for message in messages] == sorted(
        set(first_numbers(COUNT)) & {message.data for message in messages}, key=number_of
    )
    assert missing
    with pytest.raises(UnreadableFile, match="is incomplete"):
        list(read_messages(path))
    salvage = recover(path, folder / "recovered.mcap")
    assert salvage.lost
    assert salvage.message_count == len(messages)
    assert len(read_strictly(salvage.target)) == len(messages)
    with Recording(path) as recording:
        clip = cut_clip(recording, Moment(recording.info().start_ns), ALWAYS, folder / "clip.mcap")
        in_order: list[str] = []
        written = list(recording.in_order_written(None, in_order.append))
    assert clip.lost
    assert clip.message_count == len(messages)
    assert in_order or recording.missing
    assert len(written) == len(messages)


CHUNKS, SEVERAL = ("a chunk", "several chunks")
PAGES = {"the first page": 0, "a page": PAGE, "a later page": 3 * PAGE}


@pytest.mark.parametrize(
    ("write", "zeroed"),
    [
        pytest.param(write, zeroed, id=f"{writer}: {zeroed}")
        for writer, write in WRITERS.items()
        for zeroed in (CHUNKS, SEVERAL, *PAGES, "the tail")
        # without checksums nobody can tell a message cut by zeros from one that was sent so
        if "without checksums" not in writer or zeroed in (CHUNKS, SEVERAL)
    ],
)
def test_zeros_are_named(tmp_path: Path, write: Callable[[Path], Path], zeroed: str) -> None:
    path = write(tmp_path)
    chunks, size = chunks_of(path.read_bytes()), path.stat().st_size
    if zeroed in PAGES:
        zero(path, PAGES[zeroed], PAGES[zeroed] + PAGE)
    elif zeroed == "the tail":
        zero(path, size // 2, size)
    else:
        for number in (10,) if zeroed == CHUNKS else (0, 7, 8, len(chunks) - 1):
            zero(path, *chunks[number])
    assert_loss_is_named(path, tmp_path)
    if zeroed == SEVERAL:
        assert len(salvaged(path)[1]) == 4
    if zeroed == "the tail":
        assert any("they are zeros" in sentence for sentence in read_info(path).missing)


@pytest.mark.parametrize("shift", [0, 1, 9, 17, 25, 32, 44, 69])
def test_zeros_that_begin_anywhere_in_the_head_of_a_chunk_are_named(
    tmp_path: Path, shift: int
) -> None:
    path = recorded(tmp_path / "run", COUNT)
    start, end = chunks_of(path.read_bytes())[10]
    zero(path, start + shift, end)
    messages, missing = salvaged(path)
    assert len(messages) == COUNT - 1024 // 83
    assert len(missing) == 1
    path.write_bytes(path.read_bytes()[:-30])  # without the index
    messages, missing = salvaged(path)
    assert len(messages) == COUNT - 1024 // 83
    assert missing


@pytest.mark.parametrize("field", ["length", "start", "end", "size"])
def test_a_chunk_that_is_not_what_the_index_says_is_named(tmp_path: Path, field: str) -> None:
    """The checksum covers only the messages, not the fields before them."""
    path = recorded(tmp_path / "run", COUNT, compression=Compression.NONE)
    start, _ = chunks_of(path.read_bytes())[10]
    flip(path, start + {"length": 1, "start": 9, "end": 17, "size": 25}[field], 1)
    messages, missing = salvaged(path)
    assert len(messages) == COUNT - 1024 // 83
    assert len(missing) == 1


def test_times_that_the_chunk_indexes_contradict_are_not_believed(tmp_path: Path) -> None:
    path = foreign(tmp_path / "a.mcap", COUNT, enable_crcs=False)
    before = read_info(path)
    times = struct.pack("<QQ", before.start_ns, before.end_ns)
    head, _, tail = path.read_bytes().rpartition(times)
    path.write_bytes(head + times[8:] + times[:8] + tail)
    assert read_info(path) == before


def test_messages_that_the_summary_counts_and_that_are_not_there_are_named(tmp_path: Path) -> None:
    """The chunk has no checksum, and its framing alone does not show the loss."""
    path = foreign(tmp_path / "a.mcap", COUNT, compression=CompressionType.NONE, enable_crcs=False)
    data = path.read_bytes()
    first = data.index(struct.pack("<BQ", Opcode.MESSAGE, 74), chunks_of(data)[10][0])
    overwrite(path, first, b"\x80")  # a private opcode, which readers skip
    messages, missing = salvaged(path)
    assert len(messages) == COUNT - 1
    assert missing == [f"a.mcap: its summary counts {COUNT} messages, and {COUNT - 1} are there"]
    assert recover(path, tmp_path / "out.mcap").lost == (
        f"its summary counts {COUNT} messages, and {COUNT - 1} are there",
    )


def test_a_folder_with_a_zeroed_chunk_is_recovered_with_loss(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", COUNT)
    zero(path, *chunks_of(path.read_bytes())[3])
    salvage = recover_folder(tmp_path / "run", tmp_path / "saved")
    (lost,) = salvage.lost
    assert "replaced by zeros" in lost
