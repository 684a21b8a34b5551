"""A part of a recording is read without the parts before and after it."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import IndexType, Writer

from robotctl.recording import Message, Recording
from robotctl.recording.read.mcap_input import InputFile
from tests.support.recordings import numbered

TOPICS = ("/a", "/b", "/map")

written = st.lists(st.tuples(st.sampled_from(TOPICS), st.integers(0, 30)), max_size=40)
moments = st.integers(0, 31)
"""Log times collide and run backwards, and chunks overlap."""


def write(path: Path, messages: list[tuple[str, int]], **options: object) -> Path:
    """Write a file with chunks of about three messages."""
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 200, **options})  # type: ignore[arg-type]
        writer.start()
        channels = {topic: writer.register_channel(topic, "cdr", 0) for topic in TOPICS}
        for number, (topic, at_ns) in enumerate(messages):
            writer.add_message(channels[topic], at_ns, numbered(number, 48), at_ns, number)
        writer.finish()
    return path


def everything(recording: Recording) -> list[Message]:
    return list(recording.messages(None, pytest.fail))


@settings(max_examples=60)
@given(written, moments, moments, st.sampled_from([IndexType.ALL, IndexType.NONE]))
def test_a_window_holds_the_messages_of_its_time(
    messages: list[tuple[str, int]], first: int, last: int, index: IndexType
) -> None:
    with TemporaryDirectory() as folder:
        path = write(Path(folder) / "run.mcap", messages, index_types=index)
        with Recording(path) as recording:
            found = list(recording.messages(None, pytest.fail, (first, last)))
            assert found == [m for m in everything(recording) if first <= m.log_ns <= last]


@settings(max_examples=60)
@given(written, moments, st.integers(1, 3), st.sampled_from([IndexType.ALL, IndexType.NONE]))
def test_looking_back_finds_the_last_messages_of_each_topic(
    messages: list[tuple[str, int]], moment: int, count: int, index: IndexType
) -> None:
    wanted = {"/map": count, "/a": 1}
    with TemporaryDirectory() as folder:
        path = write(Path(folder) / "run.mcap", messages, index_types=index)
        with Recording(path) as recording:
            found = recording.last_before(moment, wanted, pytest.fail)
            before = [m for m in everything(recording) if m.log_ns < moment]
    assert [m.log_ns for m in found] == sorted(m.log_ns for m in found)
    for topic in TOPICS:
        last = [m for m in before if m.topic == topic][-wanted.get(topic, 0) :]
        assert [m for m in found if m.topic == topic] == (last if topic in wanted else [])


def test_what_lies_outside_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    messages = [("/map", 5)] + [("/a", at) for at in range(10, 10_000)]
    path = write(tmp_path / "run.mcap", messages)
    read_bytes = 0
    read = InputFile.read

    def counted(file: InputFile, offset: int, length: int) -> bytes:
        nonlocal read_bytes
        read_bytes += length
        return read(file, offset, length)

    with Recording(path) as recording:
        monkeypatch.setattr(InputFile, "read", counted)
        window = (9_000, 9_010)
        assert [m.log_ns for m in recording.messages(None, pytest.fail, window)] == [
            *range(9_000, 9_011)
        ]
        held = recording.last_before(9_000, {"/map": 1, "/b": 1}, pytest.fail)
        assert [(m.topic, m.log_ns) for m in held] == [("/map", 5)]
    assert 0 < read_bytes < 5_000
