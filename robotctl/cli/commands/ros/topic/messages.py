"""The messages of `topic echo` and `hz`: from a recording, and as text or JSON."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from robotctl.base.errors import UnreadableFile, UsageError
from robotctl.cli.targets.recordings import find_recording
from robotctl.cli.ui.ros_text import SHOWN_LENGTH, message_lines, plain_json
from robotctl.cli.ui.text import json_text
from robotctl.kernel.units import NS_PER_S
from robotctl.messages.definition import Definition
from robotctl.messages.fields import WrongValue, parse_path, value_at
from robotctl.messages.values import Decoder
from robotctl.recording import Message, read_info, read_messages
from robotctl.recording.table import choose_topic


class RecordedTopic:
    """A topic in a recording; `file` names the recording in a form that `find_recording` reads."""

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
        """Yield the messages of the topic in the order of their log times.

        Raises:
            UnreadableFile: Not everything can be read; raised after the last message.
        """
        for message in read_messages(self._path, {self.name}):
            if message.type_name == self.info.type_name:
                yield message


class Printer:
    """Prints the messages of one topic."""

    def __init__(
        self, topic: str, type_name: str, definition: Definition, field: str, *, full_length: bool
    ) -> None:
        """Print whole messages, or the `field` of each.

        Raises:
            UsageError: The type has no such field.
        """
        self._topic = topic
        self._type_name = type_name
        self._decoder = Decoder(definition)
        self._limit = None if full_length else SHOWN_LENGTH
        try:
            self._steps = parse_path(definition, field).steps if field else ()
        except WrongValue as error:
            raise UsageError(str(error)) from None

    def print_json(self, data: bytes, time_ns: int, publish_ns: int) -> None:
        """Print one line of JSON with the whole `message`, or the `value` of the field."""
        key = "value" if self._steps else "message"
        told = {
            "topic": self._topic,
            "type": self._type_name,
            "time_ns": time_ns,
            "publish_ns": publish_ns,
            key: plain_json(self._value(data)),
        }
        print(json_text(told), flush=True)

    def print_lines(self, data: bytes, time_ns: int | None) -> None:
        """Print YAML and `---`, or one line if the field has a single value.

        `time_ns`, unless None, comes first, as seconds: in a YAML comment or on the value's line.
        """
        value = self._value(data)
        lines = list(message_lines(value, self._limit))
        time = "" if time_ns is None else f"{time_ns // NS_PER_S}.{time_ns % NS_PER_S:09d}"
        if isinstance(value, dict | list | bytes):
            print(*([f"# {time}"] if time else []), *lines, "---", sep="\n", flush=True)
        else:
            print(*([time] if time else []), *lines, flush=True)

    def _value(self, data: bytes) -> Any:
        try:
            return value_at(self._decoder.values(data), self._steps)
        except struct.error as error:
            raise UnreadableFile(f"a message of {self._topic} cannot be read: {error}") from None
        except WrongValue as error:
            raise UsageError(str(error)) from None
