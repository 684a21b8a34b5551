"""The index of any MCAP file, the quick way if there is one."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotctl.recording.format.metadata_names import OWN_LIBRARY
from robotctl.recording.read.compressed_messages import ZSTD, message_compression
from robotctl.recording.read.damage import Damaged
from robotctl.recording.read.file_index import FileIndex
from robotctl.recording.read.mcap_input import InputFile
from robotctl.recording.read.scan import index_by_scanning, read_gaps
from robotctl.recording.read.summary_section import index_from_summary

_GROWING_S = 2.0
"""How long a file that is being written is looked at anew before it is scanned."""

_LOOK_AGAIN_S = 0.002


def index_of(
    file: InputFile,
    on_progress: Callable[[int], None] = lambda offset: None,
    *,
    places: bool = True,
) -> FileIndex:
    """By the summary if that is valid, else by scanning, which tells the offset it has reached.

    Whoever will read no message says so by `places`, which saves time.

    Raises Damaged if not even the header can be read.
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
        time.sleep(_LOOK_AGAIN_S)  # a write may be half done for as long as its process waits
    return index_by_scanning(file, on_progress)


def _complete(file: InputFile, index: FileIndex) -> None:
    """Find what the summary leaves out. In a file of ours that is nothing, or told by its counts.

    A commit that a kill has torn leaves a gap in ours which is no part of the file yet.
    """
    if not index.library.startswith(OWN_LIBRARY) or index.declared_metadata > len(index.metadata):
        read_gaps(file, index)
    for told, found, noun in (
        (index.declared_attachments, len(index.attachments), "attachments"),
        (index.declared_metadata, len(index.metadata), "metadata records"),
    ):
        if told > found and not index.missing:
            index.miss(f"its summary counts {told} {noun}, and {found} are there")
