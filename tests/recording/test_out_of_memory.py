"""Without memory messages are dropped and counted; the recorder continues when there is memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robotctl.recording import Recorder, RecorderOptions, RecorderState
from robotctl.recording.write.buffer import ChunkEncoder, LargeMessage, PackBuffer
from robotctl.recording.write.writer_thread import WriterThread
from robotctl.testing.drives import TWIST
from tests.support.recordings import (
    fork_server,
    read_strictly,
    record_without_memory,
    write_numbered,
)
from tests.support.waiting import until

CHUNK_BYTES = 4096


@pytest.fixture
def recorder(tmp_path: Path) -> Recorder:
    options = RecorderOptions(chunk_bytes=CHUNK_BYTES, flush_s=0.005)
    return Recorder(tmp_path / "run", options, on_failure=pytest.fail)


def without_memory(wanted: Callable[..., Any], times: int) -> Callable[..., Any]:
    """Return a function that raises MemoryError in its first calls."""
    left = [times]

    def call(*arguments: Any, **options: Any) -> Any:
        left[0] -= 1
        if left[0] >= 0:
            raise MemoryError
        return wanted(*arguments, **options)

    return call


@pytest.mark.parametrize(
    ("place", "name", "size"),
    [
        (ChunkEncoder, "_encode", 52),
        (PackBuffer, "take", 52),
        (PackBuffer, "__init__", 52),
        (LargeMessage, "take", CHUNK_BYTES),
        (LargeMessage, "__init__", CHUNK_BYTES),
    ],
)
def test_what_finds_no_memory_is_dropped_and_counted_and_the_next_is_written(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch, place: Any, name: str, size: int
) -> None:
    channel = recorder.add_topic(TWIST)
    monkeypatch.setattr(place, name, without_memory(getattr(place, name), 3))
    for number in range(1, 1001):
        write_numbered(recorder, channel, range(number, number + 1), size)
        if number % 20 == 0:
            until(lambda: recorder.stats().queued == 0)
    stats = recorder.close()
    assert (stats.received, stats.queued, stats.failure) == (1000, 0, "")
    assert stats.received == stats.written + stats.dropped
    assert stats.no_memory == stats.dropped < 500
    numbers = [message.sequence for message in read_strictly(stats.file)]
    assert len(numbers) == stats.written
    assert numbers[-1] == 1000
    assert numbers == sorted(set(numbers))


def test_without_any_memory_at_the_end_nothing_stays_queued(
    recorder: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PackBuffer, "take", without_memory(PackBuffer.take, 10**9))
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 101))
    stats = recorder.close()
    assert (stats.written, stats.dropped, stats.queued) == (0, 100, 0)
    assert stats.state is RecorderState.CLOSED
    assert read_strictly(stats.file) == []


def test_the_thread_survives_a_failure_that_it_cannot_even_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures: list[str] = []
    recorder = Recorder(tmp_path / "run", on_failure=failures.append)
    monkeypatch.setattr(WriterThread, "_turn", without_memory(WriterThread._turn, 3))
    monkeypatch.setattr(WriterThread, "_fail", without_memory(WriterThread._fail, 2))
    until(lambda: recorder.stats().failure)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 11))
    stats = recorder.close()
    assert failures == [stats.failure]
    assert "MemoryError" in stats.failure
    assert stats.failure.endswith("; free memory")
    assert (stats.dropped, stats.queued) == (10, 0)


def test_a_message_that_is_packed_by_half_leaves_the_others_whole(recorder: Recorder) -> None:
    channel = recorder.add_topic(TWIST)
    write_numbered(recorder, channel, range(1, 11))
    until(lambda: recorder.stats().queued == 0)
    write_numbered(recorder, channel, range(11, 12))

    class FullIndex(list[int]):
        def append(self, number: int) -> None:
            if len(self) % 2:
                raise MemoryError
            super().append(number)

    indexes: Any = recorder._buffer.indexes
    whole, indexes[channel] = indexes[channel], FullIndex()
    write_numbered(recorder, channel, range(12, 13))
    assert indexes[channel] == []
    indexes[channel] = whole
    write_numbered(recorder, channel, range(13, 20))
    stats = recorder.close()
    assert (stats.written, stats.dropped, stats.no_memory) == (18, 1, 1)
    assert [m.sequence for m in read_strictly(stats.file)] == [*range(1, 12), *range(13, 20)]


def test_in_an_address_space_that_is_full_all_is_accounted_for(tmp_path: Path) -> None:
    with fork_server() as context:
        ours, theirs = context.Pipe()
        child = context.Process(target=record_without_memory, args=(tmp_path / "run", theirs))
        child.start()
        assert ours.poll(60)
        failures, received, stats = ours.recv()
        child.join()
    assert child.exitcode == 0
    assert stats.received == received == stats.written + stats.dropped
    assert stats.queued == 0
    assert stats.dropped > 0
    assert len(failures) <= 1
    assert len(read_strictly(stats.file)) == stats.written
