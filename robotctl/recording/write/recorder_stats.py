"""What can be asked of the recorder: how it is, and what became of the messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from robotctl.recording.format.topics import TopicStats


class RecorderState(StrEnum):
    """What the recorder does with a message: keeps it, or counts it as dropped."""

    RECORDING = "recording"
    FAILED = "failed"
    CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class RecorderStats:
    """The recorder at one instant.

    `file` is the current file, `bytes` what all files have on disk; the counts are the sums over
    `topics`. Of the dropped messages, `no_memory` found no memory.
    `not_repeated` latched messages are recorded once and not repeated in later files, for there is
    no room for them. `failure` and `warning` are sentences, empty where all is well.
    """

    state: RecorderState
    file: Path
    bytes: int
    received: int
    written: int
    queued: int
    dropped: int
    lost: int
    unseen: int
    not_repeated: int
    no_memory: int
    failure: str
    warning: str
    topics: tuple[TopicStats, ...]
