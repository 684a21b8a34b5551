"""A file that claims huge sizes costs no memory."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import Writer

from robotctl.recording import read_info
from robotctl.recording.format.records import MAGIC
from tests.support.recordings import (
    numbered,
    salvaged,
)


def crafted(chunk: bytes) -> bytes:
    """Return a file of another writer whose only chunk has this content."""
    header = b"\x01" + (8).to_bytes(8, "little") + bytes(8)
    return MAGIC + header + b"\x06" + len(chunk).to_bytes(8, "little") + chunk


def chunk_content(
    compression: bytes, size: int, data: bytes, data_size: int | None = None
) -> bytes:
    return (
        struct.pack("<QQQII", 0, 1, size, 0, len(compression))
        + compression
        + (len(data) if data_size is None else data_size).to_bytes(8, "little")
        + data
    )


def zeros(size: int, compress: Callable[[], zstandard.ZstdCompressionObj]) -> bytes:
    stream = compress()
    block = bytes(1 << 20)
    return b"".join([*(stream.compress(block) for _ in range(size >> 20)), stream.flush()])


GIB = 1 << 30


@pytest.mark.parametrize(
    "content",
    [
        lambda: chunk_content(b"zstd", 2**63, b"x"),
        lambda: chunk_content(b"zstd", 100, zeros(GIB, zstandard.ZstdCompressor().compressobj)),
        lambda: chunk_content(
            b"zstd", GIB, zeros(GIB, lambda: zstandard.ZstdCompressor().compressobj(size=GIB))
        ),
        lambda: chunk_content(
            b"zstd", 100, zeros(GIB, lambda: zstandard.ZstdCompressor().compressobj(size=GIB))
        ),
        lambda: chunk_content(b"lz4", 2**62, lz4.frame.compress(bytes(1000))),
        lambda: chunk_content(b"lz4", 100, lz4.frame.compress(bytes(GIB // 8))),
        lambda: chunk_content(b"", 2**40, b"", 2**40),
        lambda: chunk_content(b"", 100, b"", 2**64 - 1),
        lambda: chunk_content(b"rar", 100, b"x" * 100),
        lambda: chunk_content(b"\xff" * 20, 100, b"x" * 100),
        lambda: struct.pack("<QQQII", 0, 1, 5, 0, 2**32 - 1),
        lambda: b"short",
    ],
)
def test_what_claims_to_be_huge_is_refused_before_memory_is_taken(
    tmp_path: Path, content: Callable[[], bytes]
) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(crafted(content()))
    tracemalloc.start()
    try:
        info = read_info(path)
        messages, missing = salvaged(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (info.message_count, messages) == (0, [])
    assert missing == list(info.missing) != []
    assert peak < 16 << 20


def test_chunks_that_all_overlap_are_not_all_held_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.recording.read.read_limits.OPEN_BYTES", 10_000)
    monkeypatch.setattr("robotctl.recording.read.read_limits.OPEN_RATIO", 0)
    path = tmp_path / "overlap.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=3000)
        writer.start()
        channel = writer.register_channel("/a", "cdr", 0)
        for number in range(1000):
            writer.add_message(channel, number % 20, numbered(number), 0)
        writer.finish()
    messages, missing = salvaged(path)
    assert 100 < len(messages) < 1000
    assert any("too many chunks overlap in time" in sentence for sentence in missing)
