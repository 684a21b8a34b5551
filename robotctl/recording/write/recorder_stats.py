"""What the recorder reports: its state, and the counts of messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from robotctl.recording.format.message_counts import MessageCounts
from robotctl.recording.format.topics import TopicStats


class RecorderState(StrEnum):
    """Whether the recorder keeps messages, or counts them as dropped."""

    RECORDING = "recording"
    FAILED = "failed"
    CLOSED = "closed"


@dataclass(slots=True, kw_only=True)
class RecorderStats(MessageCounts):
    """The recorder at one instant; the counts are the sums over `topics`.

    `file` is the current file, `bytes` the size of all files of this recording. `no_memory` counts
    the dropped messages for which there was no memory. `failure` and `warning` are
    sentences, or "".
    """

    state: RecorderState
    file: Path
    bytes: int
    no_memory: int
    failure: str
    warning: str
    topics: tuple[TopicStats, ...]
