"""What can be asked of the recorder: how it is, and what became of the messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from robotctl.recording.format.message_counts import MessageCounts
from robotctl.recording.format.topics import TopicStats


class RecorderState(StrEnum):
    """What the recorder does with a message: keeps it, or counts it as dropped."""

    RECORDING = "recording"
    FAILED = "failed"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderStats(MessageCounts):
    """The recorder at one instant; the counts are the sums over `topics`.

    `file` is the current file, `bytes` the size of all files on disk. Of the dropped messages,
    `no_memory` found no memory. `failure` and `warning` are sentences, empty where all is well.
    """

    state: RecorderState
    file: Path
    bytes: int
    no_memory: int
    failure: str
    warning: str
    topics: tuple[TopicStats, ...]
