"""A part of a recording that a check looks at together."""

from __future__ import annotations

from collections import defaultdict

from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.read.messages import Message
from robotctl.rerun.entry_order import Gap
from robotctl.rerun.journal_steps import LogTimes, Step

End = Message | JournalEntry | Gap
"""What ends a batch: a message that is compared on its own, a snapshot, or a gap in the journal."""


class Batch:
    """Steps and messages in the order of writing, and apart; then perhaps what ends it."""

    __slots__ = ("end", "end_log_times", "items", "log_times", "messages", "steps")

    def __init__(self) -> None:
        self.items: list[Step | Message] = []
        self.steps: list[Step] = []
        self.log_times: list[LogTimes] = []
        """Those of each step."""

        self.messages: defaultdict[str | None, list[Message]] = defaultdict(list)
        """The messages by topic."""

        self.end: End | None = None
        self.end_log_times: LogTimes = (0, 0)

    def add(self, step: Step, log_times: LogTimes) -> None:
        """Append a step."""
        self.items.append(step)
        self.steps.append(step)
        self.log_times.append(log_times)

    def add_message(self, message: Message) -> None:
        """Append a message that can be taken with ordinary steps."""
        self.items.append(message)
        self.messages[message.topic].append(message)
