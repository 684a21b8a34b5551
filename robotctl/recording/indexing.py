"""The index of any MCAP file, the quick way if there is one."""

from __future__ import annotations

import time
from collections.abc import Callable

from robotctl.recording.file_index import FileIndex
from robotctl.recording.mcap_input import Damaged, InputFile
from robotctl.recording.scan import index_by_scanning
from robotctl.recording.summary import index_from_summary

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
    deadline = time.monotonic() + _GROWING_S
    while True:
        try:
            return index_from_summary(file, places=places)
        except Damaged:
            if not file.is_changing() or time.monotonic() > deadline:
                break
        time.sleep(_LOOK_AGAIN_S)  # a write may be half done for as long as its process waits
    return index_by_scanning(file, on_progress)
