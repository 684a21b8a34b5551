"""What a recording says it holds, beside its files' own summaries, against what is in the files.

A file that somebody has cut, or put another in the place of, may be whole in itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robotctl.recording.format.ledger_record import read_ledger
from robotctl.recording.format.metadata_names import (
    CLIP_RECORD,
    LEDGER_RECORD,
    OWN_LIBRARY,
    RECOVERY_RECORD,
)
from robotctl.recording.format.rosbag2 import message_counts_in, total_count_in
from robotctl.recording.read.messages import OpenFile


def find_shortfalls(text: str, files: Sequence[OpenFile], *, all_files: bool) -> Iterator[str]:
    """A sentence for each thing that holds fewer messages than are told of it.

    `text` is that of the `metadata.yaml` beside the files, read before them, for they may grow;
    `all_files` says that these are all of its files.
    """
    if any(each.index.limit_reached for each in files):
        return  # more is there than was read
    told, there = message_counts_in(text), sum(each.index.message_count for each in files)
    found = [
        f"{each.path.name}: metadata.yaml counts {told[each.path.name]} messages, "
        f"and {each.index.message_count} are there"
        for each in files
        if _is_own(each) and told.get(each.path.name, 0) > each.index.message_count
    ]
    # rosbag2 counts for a file what its cache then dropped; its total is true.
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
    """Whether these are a recording of ours from its beginning, of which no part was left out."""
    first = files[0].path.stem
    names = [f"{first.removesuffix('0')}{number}" for number in range(len(files))]
    return (
        first.endswith("_0")
        and [each.path.stem for each in files] == names
        and not any(each.index.has_metadata(CLIP_RECORD, RECOVERY_RECORD) for each in files)
    )


def _written_by_ledger(last: OpenFile) -> int:
    """How many messages the recording has, by the ledger of its last file; 0 without one.

    Later files repeat messages that are latched, so there may be more.
    """
    records = [each.metadata for each in last.index.metadata if each.name == LEDGER_RECORD]
    ledger = read_ledger({LEDGER_RECORD: records[-1]} if records else {})
    return sum(counts.get("written", 0) for counts in ledger.values())
