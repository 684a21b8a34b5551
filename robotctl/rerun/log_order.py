"""Finds messages that were recorded at another time than those around them in the file."""

from __future__ import annotations

from typing import Final

from robotctl.kernel.units import NS_PER_S
from robotctl.recording.read.messages import Message

APART_NS: Final = 5 * NS_PER_S
"""How far log times may go back in a file: it is written at least once a second, by kinds."""


class LogOrder:
    """The log times of messages in the order of writing, as far as they go back."""

    def __init__(self) -> None:
        self.steps_back = 0
        """How often a message is much earlier than one before it."""

        self.example = ""
        self._newest_ns = 0

    def add(self, message: Message) -> None:
        """Note the next message of a file."""
        if message.log_ns < self._newest_ns - APART_NS:
            self.steps_back += 1
            self.example = self.example or message.topic
            self._newest_ns = message.log_ns
        self._newest_ns = max(self._newest_ns, message.log_ns)
