"""Bags in which rosbag2 compressed each message separately (`compression_mode: message`)."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from mcap.records import Metadata
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from robotctl.recording.format.rosbag2 import METADATA_RECORD, files_in, metadata_text
from robotctl.recording.read.damage import BeyondLimit, Damaged
from robotctl.recording.read.read_limits import ReadLimits, ReadTally, unpacking_cost

SERIALIZED_METADATA: Final = "serialized_metadata"

ZSTD: Final = "zstd"
"""The only format for which rosbag2 has a plugin."""

# Possessive (`*+`): any text takes time in proportion to its length.
_MODE = re.compile(r"^( *+compression_mode: *+)[\"']?(\w*+)[\"']?(?= *+$)", re.MULTILINE)
_FORMAT = re.compile(r"^( *+compression_format: *+)[\"']?(\w*+)[\"']?(?= *+$)", re.MULTILINE)


def message_compression(metadata: Iterable[Metadata], path: Path) -> str:
    """Return the compression of the messages in the file `path`, or "" for none.

    The file's own metadata decides. If it says nothing, the `metadata.yaml` that lists the file
    decides.
    """
    texts = [
        record.metadata.get(SERIALIZED_METADATA, "")
        for record in metadata
        if record.name == METADATA_RECORD
    ]
    for text in texts[::-1]:
        if _MODE.search(text):
            return _format_in(text)
    text = metadata_text(path)
    return _format_in(text) if path.name in files_in(text) else ""


def without_compression(values: dict[str, str]) -> dict[str, str]:
    """Return rosbag2's metadata record for a copy in which the messages are not compressed."""
    if SERIALIZED_METADATA not in values:
        return values
    text = values[SERIALIZED_METADATA]
    for pattern in (_MODE, _FORMAT):
        text = pattern.sub(r'\1""', text)
    return values | {SERIALIZED_METADATA: text}


def _format_in(text: str) -> str:
    mode, form = _MODE.search(text), _FORMAT.search(text)
    if mode is None or mode[2].lower() != "message":
        return ""
    return form[2].lower() if form else "an unknown format"


class MessageDecompressor:
    """Decompresses the messages at one place of a file, within the file's limits."""

    def __init__(self, offset: int, limits: ReadLimits, tally: ReadTally) -> None:
        """Set up a decompressor for the place at `offset`; `tally` is that of the file."""
        self._offset = offset
        self._limits = limits
        self._account = tally
        self._cost = 0
        self._zstd = ZstdDecompressor()

    def decompress(self, frame: bytes) -> bytes:
        """Return the message in a zstd frame.

        Raises:
            Damaged: The frame is corrupt, or exceeds the limits.
        """
        try:
            size = frame_content_size(frame)
            self._spend(size)
            return self._zstd.decompress(frame, max_output_size=size)
        except (ZstdError, ValueError, MemoryError) as error:
            raise Damaged("messages are not compressed as the metadata says") from error

    def _spend(self, size: int) -> None:
        if size > self._limits.chunk_bytes:
            raise BeyondLimit(
                f"a message claims {size} bytes, more than {self._limits.chunk_bytes}"
            )
        self._cost += unpacking_cost(max(size, 0))
        limit = self._limits.unpacked_cost
        if self._cost > self._account.unpacked_left(self._offset, limit):
            raise BeyondLimit(f"unpacked it would take more than {limit >> 20} MiB")
        self._account.note_unpacked(self._offset, self._cost)
