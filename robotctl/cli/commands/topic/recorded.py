"""The messages of one topic of a recording."""

from __future__ import annotations

from collections.abc import Iterator

from robotctl.cli.support.recording_paths import find_recording
from robotctl.recording import Message, read_info, read_messages
from robotctl.recording.table.topic_choice import choose_topic


class RecordedTopic:
    """A topic of a recording, which `find_recording` finds by its name."""

    def __init__(self, file: str, topic: str, type_name: str) -> None:
        """Find the topic; a leading / may be left out.

        Raises:
            UsageError: The recording has no such topic, or it has several types.
            UnreadableFile: Nothing can be read, or the messages are not in CDR.
        """
        self._path = find_recording(file, None)
        listing = f"robotctl topic list --file {file}"
        self.info = choose_topic(read_info(self._path), topic, type_name, listing=listing)
        self.name = self.info.name

    def messages(self) -> Iterator[Message]:
        """Yield its messages in the order of their log time.

        Raises:
            UnreadableFile: Not everything can be read; raised after the last message.
        """
        for message in read_messages(self._path, {self.name}):
            if message.type_name == self.info.type_name:
                yield message
