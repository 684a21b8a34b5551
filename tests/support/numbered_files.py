"""Files of numbered messages in small chunks, for tests that damage them and read them back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap.writer import Writer

from robotctl.recording import Message, Recorder, RecorderOptions, read_messages
from robotctl.testing.drives import START_NS, TWIST
from tests.support.recordings import numbered, write_numbered

CHUNK_BYTES = 1024


def recorded(folder: Path, count: int, **options: Any) -> Path:
    """Write a recording with `count` messages by robotctl."""
    recorder = Recorder(
        folder, RecorderOptions(**{"chunk_bytes": CHUNK_BYTES, **options}), on_failure=print
    )
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, count + 1))
    stats = recorder.close()
    assert stats.written == count, stats.failure
    return stats.file


def foreign(path: Path, count: int, **options: Any) -> Path:
    """Write a file by the writer of the mcap package."""
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": CHUNK_BYTES, **options})
        writer.start(profile="ros2", library="somebody")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/cmd_vel", "cdr", schema)
        for number in range(1, count + 1):
            stamp = START_NS + number * 1_000_000
            writer.add_message(channel, stamp, numbered(number), stamp, number)
        writer.finish()
    return path


def salvaged(path: Path) -> tuple[list[Message], list[str]]:
    """Return all messages that can be read, and what is reported missing."""
    missing: list[str] = []
    return list(read_messages(path, on_missing=missing.append)), missing


def first_numbers(count: int) -> list[bytes]:
    """Return the data of the first messages."""
    return [numbered(number) for number in range(1, count + 1)]
