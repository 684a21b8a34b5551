"""Compressions are listed once: all that are written can be read, and unknown ones are errors."""

from __future__ import annotations

import pytest

from robotctl.config import Config, with_setting
from robotctl.errors import ConfigError
from robotctl.recording import Compression
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.stored_chunk import decompressor_of
from robotctl.recording.write.buffer import ChunkEncoder, pack


@pytest.mark.parametrize("compression", list(Compression))
def test_every_compression_of_the_configuration_is_recorded_and_read(
    compression: Compression,
) -> None:
    config = with_setting(Config(), "recording.compression", compression.value)
    encoder = ChunkEncoder(config.recording.compression, 1)
    message = (1, bytes(10_000), 2, 3, 4)
    chunk = encoder.encode(pack([message]))
    stored = b"".join(chunk.parts)
    assert (len(stored) < 1000) is (compression is not Compression.NONE)
    unpacked = decompressor_of(chunk.compression).unpack(stored, chunk.uncompressed_size)
    assert unpacked == b"".join(pack([message]).parts)


def test_an_unknown_compression_is_refused_and_never_taken_for_none() -> None:
    with pytest.raises(ConfigError, match=r"recording\.compression: 'lz5'.*use zstd, lz4, none"):
        with_setting(Config(), "recording.compression", "lz5")
    with pytest.raises(Damaged, match="compressed by 'lz5', which is not supported"):
        decompressor_of("lz5")
