"""Tells who wrote a recorded journal: the recorder itself, or a robot that it observed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from robotctl.recording import RecordingInfo
from robotctl.recording.format.event_kind import EventKind
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

_OWN_NAMES: Final = ("topic.", "service.")
"""The beginnings of the keys by which the metadata of a robot names its topics and services."""


class JournalOrigin:
    """Who wrote a journal. A recorder stamps the entries that it writes itself as it records them,
    and an observer writes none.
    """

    def __init__(self, info: RecordingInfo, topic: str) -> None:
        """`topic` is that of the journal."""
        self._info = info
        self._topic = topic
        self._noted = info.metadata.get(INFO_RECORD, {})
        self._has_own_name = topic == own_journal_topic(info)
        self._observes = self._noted.get("mode") == OBSERVING
        self._was_received: bool | None = None
        """Whether the first entry was received, None before it."""

        self._has_written = False
        """Whether an observer wrote an entry itself."""

    @property
    def is_own(self) -> bool:
        """Whether the recorder wrote the journal itself, and not what it received of it."""
        return not self._was_received or (self._has_own_name and not self._observes)

    def first(self, message: Message) -> None:
        """Take the first message of the journal."""
        self._was_received = message.log_ns != message.publish_ns

    def watch(self, messages: Iterable[Message]) -> Iterable[Message]:
        """Return what is read; all entries that an observer recorded are looked at on the way."""
        return map(self._look, messages) if self._observes else messages

    def _look(self, message: Message) -> Message:
        self._has_written |= message.topic == self._topic and message.log_ns == message.publish_ns
        return message

    def check(self, report: Report) -> None:
        """Report what contradicts an observer, and what is not compared because of it."""
        if self.is_own:
            return
        report.notes.append(NOT_COMPARED)
        if not self._observes:
            report.miss("the journal of the robot that recorded is not there", is_beside=True)
        elif difference := self._contradiction():
            report.miss(f"it says that it only observed, and {difference}", is_beside=True)

    def _contradiction(self) -> str:
        """Return what an observer's recording does not hold, "" if it holds no such thing."""
        if self._has_written:
            return "it wrote entries of the journal itself"
        if any(key.startswith(_OWN_NAMES) for key in self._noted):
            return "names topics and services of its own"
        if any(event.kind is not EventKind.MARK for event in self._info.events):
            return "tells of drives or stops of its own"
        return ""
