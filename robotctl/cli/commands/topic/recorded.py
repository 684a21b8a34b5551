"""The messages of one topic of a recording."""

from __future__ import annotations

from collections.abc import Iterator

from robotctl.cli.support.recording_paths import find_recording
from robotctl.errors import UnreadableFile, UsageError
from robotctl.recording import Message, TopicInfo, read_info, read_messages
from robotctl.unknown_name import unknown_name


class RecordedTopic:
    """A topic of a recording, which `find_recording` finds by its name."""

    def __init__(self, file: str, topic: str, type_name: str) -> None:
        """Find the topic; a leading / may be left out.

        Raises:
            UsageError: The recording has no such topic, or it has several types.
            UnreadableFile: Nothing can be read, or the messages are not in CDR.
        """
        self._path = find_recording(file, None)
        topics = read_info(self._path).topics
        names = {each.name for each in topics}
        self.name = topic if topic in names else f"/{topic}"
        if self.name not in names:
            cause, cure = unknown_name("topic", topic, names)
            raise UsageError(
                f"{cause} in {self._path}", cure.replace("list", f"list --file {file}")
            )
        self.info = self._of_type([each for each in topics if each.name == self.name], type_name)
        if self.info.encoding != "cdr":
            raise UnreadableFile(
                f"{self.name} has messages in {self.info.encoding or 'no encoding'}, not in cdr"
            )

    def messages(self) -> Iterator[Message]:
        """Yield its messages in the order of their log time.

        Raises:
            UnreadableFile: Not everything can be read; raised after the last message.
        """
        for message in read_messages(self._path, {self.name}):
            if message.type_name == self.info.type_name:
                yield message

    def _of_type(self, found: list[TopicInfo], wanted: str) -> TopicInfo:
        chosen = [each for each in found if wanted in ("", each.type_name)]
        if len(chosen) == 1:
            return chosen[0]
        types = ", ".join(each.type_name for each in found)
        raise UsageError(
            f"{self.name} has the types {types} there", f"choose one: --type {found[0].type_name}"
        )
