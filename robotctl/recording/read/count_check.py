"""Comparison of the message counts that a recording declares with those in its files.

`metadata.yaml` and the ledger declare counts. A file that was cut or exchanged may be valid itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robotctl.recording.format.names import (
    CLIP_RECORD,
    LEDGER_RECORD,
    OWN_LIBRARY,
    RECOVERY_RECORD,
)
from robotctl.recording.format.rosbag2 import message_counts_in, total_count_in
from robotctl.recording.format.topics import read_ledger
from robotctl.recording.read.messages import OpenFile


def find_shortfalls(text: str, files: Sequence[OpenFile], *, all_files: bool) -> Iterator[str]:
    """Yield a sentence for each file or recording that holds fewer messages than declared.

    `text` is the `metadata.yaml` of the files, read before them, because they may grow. `all_files`
    tells that these are all files of the recording.
    """
    if any(each.index.limit_reached for each in files):
        return  # not all messages were read
    told, there = message_counts_in(text), sum(each.index.message_count for each in files)
    found = [
        f"{each.path.name}: metadata.yaml counts {told[each.path.name]} messages, "
        f"and {each.index.message_count} are there"
        for each in files
        if _is_own(each) and told.get(each.path.name, 0) > each.index.message_count
    ]
    # The counts per file of rosbag2 include messages that its cache dropped; the total does not.
    total = total_count_in(text)
    if not found and all_files and total > there:
        found.append(f"metadata.yaml counts {total} messages, and {there} are there")
    if not found and _is_whole(files):
        written = _written_by_ledger(files[-1])
        if written > there:
            found.append(f"its ledger counts {written} messages, and {there} are there")
    yield from found


def _is_own(each: OpenFile) -> bool:
    return each.index.library.startswith(OWN_LIBRARY)


def _is_whole(files: Sequence[OpenFile]) -> bool:
    """Return whether these are the consecutive files of one of our recordings, from its first file
    on.
    """
    first = files[0].path.stem
    names = [f"{first.removesuffix('0')}{number}" for number in range(len(files))]
    return (
        first.endswith("_0")
        and [each.path.stem for each in files] == names
        and not any(each.index.has_metadata(CLIP_RECORD, RECOVERY_RECORD) for each in files)
    )


def _written_by_ledger(last: OpenFile) -> int:
    """Return the message count of the recording by the ledger of its last file; 0 without one.

    Later files repeat latched messages, so the files may hold more.
    """
    records = [each.metadata for each in last.index.metadata if each.name == LEDGER_RECORD]
    ledger = read_ledger({LEDGER_RECORD: records[-1]} if records else {})
    return sum(counts.get("written", 0) for counts in ledger.values())
