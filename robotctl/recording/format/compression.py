"""The compressions that the recorder offers; this is the only list of them."""

from __future__ import annotations

from enum import Enum


class Compression(Enum):
    """How the recorder stores chunks; the values are those of `recording.compression`."""

    ZSTD = "zstd"
    LZ4 = "lz4"
    NONE = "none"

    @property
    def mcap_name(self) -> str:
        """The name in a chunk record (https://mcap.dev/spec/registry)."""
        return "" if self is Compression.NONE else self.value
