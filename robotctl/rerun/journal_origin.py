"""Tells who wrote a recorded journal: the recorder itself, or a robot that it observed."""

from __future__ import annotations

from typing import Final

from robotctl.recording import RecordingInfo
from robotctl.recording.format.metadata_names import INFO_RECORD
from robotctl.recording.read.journal_reader import own_journal_topic
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report

OBSERVING: Final = "observing"
"""The mode of a recorder that drives nothing. It may observe a robot with its own name."""

NOT_COMPARED: Final = (
    "the journal was received from the robot: not compared are parameters, statuses, calls, and "
    "what was sent after its end"
)


class JournalOrigin:
    """Who wrote a journal. A recorder stamps the entries that it writes itself as it records them,
    and an observer writes none.
    """

    def __init__(self, info: RecordingInfo, topic: str) -> None:
        """`topic` is that of the journal."""
        self._topic = topic
        self._noted = info.metadata.get(INFO_RECORD, {})
        self._has_own_name = topic == own_journal_topic(info)
        self._observes = self._noted.get("mode") == OBSERVING
        self._was_received: bool | None = None
        """Whether the first entry was received, None before it."""

    @property
    def is_own(self) -> bool:
        """Whether the recorder wrote the journal itself, and not what it received of it."""
        return not self._was_received or (self._has_own_name and not self._observes)

    def first(self, message: Message) -> None:
        """Take the first message of the journal."""
        self._was_received = message.log_ns != message.publish_ns

    def check(self, report: Report) -> None:
        """Note what is not compared in a journal that was received."""
        if self.is_own:
            return
        report.notes.append(NOT_COMPARED)
        if not self._observes:
            report.miss("the journal of the robot that recorded is not there", is_beside=True)
