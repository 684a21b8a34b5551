"""Data that a power cut replaced by zeros is reported by every command, and counts as a loss."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.writer import CompressionType

from robotctl.errors import UnreadableFile
from robotctl.recording import Compression, Recording, read_info, read_messages
from robotctl.recording.keep.clip import Moment, cut_clip
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.read.messages import ALWAYS
from robotctl.testing.faults import PAGE, chunks_of, zero
from tests.support.recordings import (
    first_numbers,
    foreign,
    number_of,
    read_strictly,
    recorded,
    salvaged,
)

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
writers = pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
with_checksums = pytest.mark.parametrize("write", list(WRITERS.values())[:4], ids=list(WRITERS)[:4])
"""Without them nobody can tell the end of a message that is zeros from one that was sent so."""


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


@writers
def test_a_zeroed_chunk_is_named(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    path = write(tmp_path)
    zero(path, *chunks_of(path.read_bytes())[10])
    assert_loss_is_named(path, tmp_path)


@writers
def test_several_zeroed_chunks_are_each_named(
    tmp_path: Path, write: Callable[[Path], Path]
) -> None:
    path = write(tmp_path)
    chunks = chunks_of(path.read_bytes())
    for number in (0, 7, 8, len(chunks) - 1):
        zero(path, *chunks[number])
    assert_loss_is_named(path, tmp_path)
    assert len(salvaged(path)[1]) == 4


@with_checksums
@pytest.mark.parametrize("page", [1, 3])
def test_a_zeroed_page_is_named(tmp_path: Path, write: Callable[[Path], Path], page: int) -> None:
    path = write(tmp_path)
    zero(path, page * PAGE, (page + 1) * PAGE)
    assert_loss_is_named(path, tmp_path)


@with_checksums
def test_a_zeroed_first_page_costs_what_was_in_it(
    tmp_path: Path, write: Callable[[Path], Path]
) -> None:
    path = write(tmp_path)
    zero(path, 0, PAGE)
    assert_loss_is_named(path, tmp_path)


@with_checksums
def test_a_zeroed_tail_is_named(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    path = write(tmp_path)
    size = path.stat().st_size
    zero(path, size // 2, size)
    assert_loss_is_named(path, tmp_path)
    assert any("they are zeros" in sentence for sentence in read_info(path).missing)


@pytest.mark.parametrize("shift", range(0, 70, 3))
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


def test_a_file_of_zeros_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "zeros.mcap"
    path.write_bytes(bytes(100_000))
    with pytest.raises(UnreadableFile, match="begins with zeros"):
        read_info(path)


@pytest.mark.parametrize("field", ["length", "start", "end", "size"])
def test_a_chunk_that_is_not_what_the_index_says_is_named(tmp_path: Path, field: str) -> None:
    """The checksum covers only the messages, not the fields before them."""
    path = recorded(tmp_path / "run", COUNT, compression=Compression.NONE)
    data = bytearray(path.read_bytes())
    start, _ = chunks_of(bytes(data))[10]
    data[start + {"length": 1, "start": 9, "end": 17, "size": 25}[field]] ^= 1
    path.write_bytes(data)
    messages, missing = salvaged(path)
    assert len(messages) == COUNT - 1024 // 83
    assert len(missing) == 1


def test_messages_that_the_summary_counts_and_that_are_not_there_are_named(tmp_path: Path) -> None:
    """The chunk has no checksum, and its framing alone does not show the loss."""
    path = foreign(tmp_path / "a.mcap", COUNT, compression=CompressionType.NONE, enable_crcs=False)
    data = bytearray(path.read_bytes())
    start, _ = chunks_of(bytes(data))[10]
    first = data.index(struct.pack("<BQ", Opcode.MESSAGE, 74), start)
    data[first] = 0x80  # a private opcode, which readers skip
    path.write_bytes(data)
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
