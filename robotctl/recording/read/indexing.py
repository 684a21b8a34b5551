"""The index of any MCAP file: from its summary if there is a valid one, else by a scan."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotctl.recording.format.names import OWN_LIBRARY
from robotctl.recording.read.compressed_messages import ZSTD, message_compression
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.scan import index_by_scanning, read_gaps
from robotctl.recording.read.summary_section import index_from_summary

_GROWING_S = 2.0
"""How long reading a growing file is retried before it is scanned."""

_LOOK_AGAIN_S = 0.002


def index_of(
    file: InputFile,
    on_progress: Callable[[int], None] = lambda offset: None,
    *,
    places: bool = True,
) -> FileIndex:
    """Return the index of a file.

    `on_progress` gets the offset that a scan has reached. With `places` False the index takes less
    time, and messages cannot be read with it.

    Raises:
        Damaged: Not even the header can be read.
    """
    index = _index_of(file, on_progress, places=places)
    index.message_compression = message_compression(index.metadata, file.path)
    if index.message_compression not in ("", ZSTD):
        index.places = []
        index.miss(
            f"its messages are compressed with {index.message_compression[:40]}, one by one: "
            "this is not supported"
        )
    return index


def _index_of(file: InputFile, on_progress: Callable[[int], None], *, places: bool) -> FileIndex:
    deadline = time.monotonic() + _GROWING_S
    while True:
        file.refresh()
        try:
            index = index_from_summary(file, places=places)
            if places:
                _complete(file, index)
            return index
        except Damaged:
            if not file.is_changing() or time.monotonic() > deadline:
                break
        time.sleep(_LOOK_AGAIN_S)  # a writer may be interrupted within a write
    return index_by_scanning(file, on_progress)


def _complete(file: InputFile, index: FileIndex) -> None:
    """Find records that the summary does not list.

    The summaries of robotctl list all records, unless their counts say otherwise. In a file of
    robotctl, a gap that a killed commit left is not part of the file.
    """
    if not index.library.startswith(OWN_LIBRARY) or index.declared_metadata > len(index.metadata):
        read_gaps(file, index)
    for told, found, noun in (
        (index.declared_attachments, len(index.attachments), "attachments"),
        (index.declared_metadata, len(index.metadata), "metadata records"),
    ):
        if told > found and not index.missing:
            index.miss(f"its summary counts {told} {noun}, and {found} are there")
