"""What the recorder promises when the disk or the process fails.

Without memory messages are dropped and counted; the recorder continues when there is memory.
"""

from __future__ import annotations

import errno
import os
import random
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from multiprocessing.context import ForkServerContext
from pathlib import Path
from shutil import rmtree
from typing import Any

import pytest

from robotctl.base.errors import Refused
from robotctl.recording import (
    Compression,
    Recorder,
    RecorderOptions,
    RecorderState,
    RecorderStats,
    read_info,
    read_messages,
)
from robotctl.recording.format.disk import Buffer, DiskFile
from robotctl.recording.format.records import MESSAGE_HEAD
from robotctl.recording.write.bag_writer import BagWriter
from robotctl.recording.write.buffer import ChunkEncoder, LargeMessage, PackBuffer
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.writer_thread import WriterThread
from robotctl.testing.drives import TWIST
from robotctl.testing.faults import FailingFile, GatedFile, VolatileFile
from tests.support.recordings import (
    Tape,
    fork_server,
    number_of,
    numbered,
    read_strictly,
    record_in_real_time,
    record_up_to_file_size,
    record_without_memory,
    write_numbered,
)
from tests.support.waiting import until

KIB = 1 << 10
CURES = {
    errno.ENOSPC: "; free disk space",
    errno.EDQUOT: "; free disk space, or ask for a higher quota",
    errno.EIO: "; check the disk and its cable (sudo dmesg)",
    errno.EROFS: "; mount the disk writable, and check why it is not (sudo dmesg)",
    errno.EACCES: "; give this user the right to write there",
    errno.EMFILE: "; raise the limit of open files (ulimit -n)",
}


@pytest.fixture(scope="module")
def fork() -> Iterator[ForkServerContext]:
    """A fork server that has the recorder imported, so that no threads are copied."""
    with fork_server("tests.support.recordings") as context:
        yield context


def assert_accounted(stats: RecorderStats, received: int) -> None:
    assert stats.received == received
    assert stats.received == stats.written + stats.queued + stats.dropped
    assert min(stats.written, stats.queued, stats.dropped) >= 0


def assert_first_numbers(file: Path, count: int) -> None:
    """Check that the file holds messages 1 to `count`, byte for byte, and nothing else."""
    messages = read_strictly(file)
    assert [(m.sequence, m.data) for m in messages] == [
        (number, numbered(number)) for number in range(1, count + 1)
    ]


def kill_at_random_instants(
    fork: ForkServerContext, folder: Path, kills: int, dice: random.Random
) -> int:
    """Record in processes that are killed, four at a time; return how many files are complete.

    Each must be readable: its messages are the first ones, byte for byte, and few are lost.
    """
    whole = 0
    for batch in range(0, kills, 4):
        children = []
        for kill in range(batch, batch + 4):
            ours, theirs = fork.Pipe()
            compression = dice.choice(list(Compression)).value
            period_s = dice.choice([0.0002, 0.001, 0.02])
            arguments = (folder / f"run{kill}", compression, period_s, theirs)
            child = fork.Process(target=record_in_real_time, args=arguments, daemon=True)
            child.start()
            children.append((child, ours))
        for child, ours in children:
            assert ours.poll(30)
            file = ours.recv()
            time.sleep(dice.uniform(0.0, 0.3))
            assert child.pid is not None
            os.kill(child.pid, signal.SIGKILL)
            killed_ns = time.time_ns()
            child.join()
            messages = list(read_messages(file, on_missing=lambda sentence: None))
            assert [(number_of(m.data), m.data) for m in messages] == [
                (number, numbered(number)) for number in range(1, len(messages) + 1)
            ]
            if messages:
                # Ten times the target of 0.3 s: other programs run here, too.
                assert killed_ns - messages[-1].log_ns < 3_000_000_000
            with suppress(Exception):  # any error: the process was killed during a write
                read_strictly(file)
                whole += 1
    return whole


def test_a_recording_opens_after_sigkill_at_any_instant(
    fork: ForkServerContext, tmp_path: Path
) -> None:
    assert kill_at_random_instants(fork, tmp_path, 8, random.Random(1)) >= 7


@pytest.mark.slow
def test_a_recording_opens_after_each_of_200_kills(fork: ForkServerContext, tmp_path: Path) -> None:
    assert kill_at_random_instants(fork, tmp_path, 200, random.Random(2)) >= 198


def test_a_file_that_may_not_grow_ends_in_one_failure_and_a_whole_file(
    fork: ForkServerContext, tmp_path: Path
) -> None:
    ours, theirs = fork.Pipe()
    child = fork.Process(
        target=record_up_to_file_size, args=(tmp_path / "run", 100_000, theirs), daemon=True
    )
    child.start()
    assert ours.poll(30)
    failures, number, stats = ours.recv()
    child.join()
    assert len(failures) == 1
    assert "File too large" in failures[0]
    assert stats.state is RecorderState.FAILED
    assert_accounted(stats, number)
    assert stats.queued == 0
    assert stats.written > 500
    assert stats.file.stat().st_size <= 100_000
    assert_first_numbers(stats.file, stats.written)


@pytest.mark.parametrize("code", CURES)
def test_each_error_of_the_disk_has_its_own_cure(tmp_path: Path, code: int) -> None:
    disk = partial(FailingFile, fail_at=2, code=code)
    recorder = Tape(tmp_path / "run", open_file=disk, may_fail=True)
    recorder.commands(range(1, 11))
    recorder.close()
    told = f"recording stopped: {os.strerror(code)} ({tmp_path / 'run' / 'run_0.mcap'})"
    assert recorder.failures == [told + CURES[code]]


def has_failed(recorder: Recorder) -> bool:
    return recorder.stats().failure != ""


@pytest.mark.parametrize("compression", list(Compression))
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_an_error_at_any_write_keeps_what_was_written_before(
    tmp_path: Path, code: int, compression: Compression
) -> None:
    for fail_at in range(2, 16):
        recorder = Tape(
            tmp_path / f"run{fail_at}",
            compression=compression,
            chunk_bytes=4 * KIB,
            open_file=partial(FailingFile, fail_at=fail_at, code=code),
            may_fail=True,
        )
        recorder.commands(range(1, 2001))
        until(partial(has_failed, recorder))
        recorder.commands(range(2001, 2101))
        stats = recorder.close()
        assert len(recorder.failures) == 1
        assert os.strerror(code) in stats.failure
        assert stats.failure.endswith(CURES[code])
        assert stats.failure == recorder.failures[0]
        assert str(stats.file) in stats.failure
        assert_accounted(stats, 2100)
        assert stats.queued == 0
        assert stats.dropped >= 100
        assert_first_numbers(stats.file, stats.written)
        assert read_info(tmp_path / f"run{fail_at}").message_count == stats.written


def test_an_error_while_closing_keeps_every_message(tmp_path: Path) -> None:
    files: list[FailingFile] = []

    class FailsAtClose(FailingFile):
        def __init__(self, path: Path) -> None:
            super().__init__(path, fail_at=10**9)
            files.append(self)

    recorder = Tape(tmp_path / "run", open_file=FailsAtClose, may_fail=True)
    recorder.commands(range(1, 101))
    until(lambda: recorder.stats().written == 100)
    files[0].fail_now()
    stats = recorder.close()
    assert len(recorder.failures) == 1
    assert_accounted(stats, 100)
    assert_first_numbers(stats.file, 100)


def test_a_file_that_was_finished_is_not_touched_when_it_fails_to_close(tmp_path: Path) -> None:
    class FailsAtClose(DiskFile):
        closed = False

        def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
            assert not self.closed
            super().write_at(parts, offset)

        def close(self) -> None:
            self.closed = True
            super().close()
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    recorder = Tape(tmp_path / "run", open_file=FailsAtClose, may_fail=True)
    recorder.commands(range(1, 101))
    stats = recorder.close()
    assert len(recorder.failures) == 1
    assert "Input/output error" in recorder.failures[0]
    assert_first_numbers(stats.file, 100)


def test_a_disk_that_is_full_at_the_start_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    options = RecorderOptions(open_file=lambda path: FailingFile(path, 1))
    with pytest.raises(Refused, match="No space left on device"):
        Recorder(tmp_path / "run", options, on_failure=pytest.fail)
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_repaired_says_so(tmp_path: Path) -> None:
    class Gone(FailingFile):
        def truncate(self, size: int) -> None:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    recorder = Tape(tmp_path / "run", open_file=lambda path: Gone(path, 2), may_fail=True)
    recorder.commands(range(1, 101))
    stats = recorder.close()
    assert "could not be repaired" in recorder.failures[0]
    assert_accounted(stats, 100)
    assert (stats.written, stats.dropped) == (0, 100)


@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_recording_that_is_removed_has_failed(tmp_path: Path, what: str) -> None:
    recorder = Tape(tmp_path / "run", flush_s=0.005, sync_s=0.01, may_fail=True)
    recorder.commands(range(1, 11))
    recorder.settle()
    recorder.stats().file.unlink()
    if what == "folder":
        # At once: meanwhile the recorder may put a new metadata.yaml into it.
        rmtree((tmp_path / "run").rename(tmp_path / "removed"))
    recorder.commands(range(11, 21))
    until(lambda: bool(recorder.failures))
    stats = recorder.close()
    assert "recording stopped: " in stats.failure
    assert "the file was removed" in stats.failure or what == "folder"
    assert_accounted(stats, 20)


def test_the_thread_that_writes_survives_what_nobody_thought_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def take(buffer: PackBuffer) -> None:
        monkeypatch.undo()
        raise RuntimeError

    monkeypatch.setattr(PackBuffer, "take", take)
    recorder = Tape(tmp_path / "run", may_fail=True)
    until(lambda: bool(recorder.failures))
    recorder.commands(range(1, 11))
    stats = recorder.close()
    assert "RuntimeError" in stats.failure
    assert (stats.state, stats.dropped, stats.queued) == (RecorderState.FAILED, 10, 0)


INDEX_ENTRY_BYTES = 16


def gated(folder: Path, memory_bytes: int) -> tuple[threading.Event, Tape]:
    """Return an event, which is set, and a recorder whose disk writes while it is set."""
    gate = threading.Event()
    gate.set()
    return gate, Tape(
        folder,
        chunk_bytes=16 * KIB,
        memory_bytes=memory_bytes,
        open_file=lambda path: GatedFile(path, gate.wait),
    )


@pytest.mark.parametrize("size", [52, 3 * KIB, 40 * KIB])
def test_a_slow_disk_fills_the_queue_and_then_counts_drops(tmp_path: Path, size: int) -> None:
    gate, recorder = gated(tmp_path / "run", 256 * KIB)
    gate.clear()
    number = 0
    while recorder.stats().dropped < 100:
        number += 1
        recorder.commands(range(number, number + 1), size)
        assert number < 20_000, "the queue has no bound"
    stuck = recorder.stats()
    assert_accounted(stuck, number)
    assert stuck.queued * (MESSAGE_HEAD.size + size + INDEX_ENTRY_BYTES) <= (256 + 16) * KIB
    gate.set()
    recorder.settle()
    recorder.commands(range(number + 1, number + 4), size)
    stats = recorder.close()
    assert_accounted(stats, number + 3)
    assert stats.dropped == stuck.dropped
    messages = read_strictly(stats.file)
    assert len(messages) == stats.written
    assert [m.sequence for m in messages[-3:]] == list(range(number + 1, number + 4))


def pack(buffer: PackBuffer, numbers: range) -> None:
    """Pack numbered messages as the recorder does."""
    for number in numbers:
        data = numbered(number)
        head = MESSAGE_HEAD.pack(5, 22 + len(data), 0, number, number, number)
        record = head + data
        buffer.data[buffer.end : buffer.end + len(record)] = record
        buffer.indexes[0].append(number)
        buffer.indexes[0].append(buffer.end)
        buffer.end += len(record)


@pytest.mark.parametrize("compression", list(Compression))
def test_after_a_power_cut_all_that_was_synced_is_readable(
    tmp_path: Path, compression: Compression
) -> None:
    dice = random.Random(3)
    disks: list[VolatileFile] = []

    def open_file(path: Path) -> VolatileFile:
        disks.append(VolatileFile(path))
        return disks[-1]

    options = RecorderOptions(compression=compression, open_file=open_file)
    channels = [ChannelState(TWIST)]
    folder = tmp_path / "run"
    folder.mkdir()
    writer = BagWriter(folder, options, dict, channels)
    buffer = PackBuffer(1 << 20)
    buffer.make_indexes(1)
    crashed = tmp_path / "crashed.mcap"
    number = synced = 0
    for _ in range(40):
        count = dice.choice([1, 5, 30])
        pack(buffer, range(number + 1, number + count + 1))
        number += count
        taken = buffer.take()
        assert taken is not None
        writer.write(taken)
        if dice.random() < 0.25:
            writer.sync()
            synced = number
        for _ in range(4):
            crashed.write_bytes(disks[0].after_power_cut(dice))
            missing: list[str] = []
            found = [m.data for m in read_messages(crashed, on_missing=missing.append)]
            assert found[:synced] == [numbered(n) for n in range(1, synced + 1)]
            later = [number_of(data) for data in found[synced:]]
            assert later == sorted(set(later) & set(range(synced + 1, number + 1)))
            gap = later and later[-1] - synced != len(later)
            assert missing or not gap
    writer.close()


CHUNK_BYTES = 4096


@pytest.fixture
def small_recorder(tmp_path: Path) -> Tape:
    return Tape(tmp_path / "run", chunk_bytes=CHUNK_BYTES, flush_s=0.005)


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
    small_recorder: Tape, monkeypatch: pytest.MonkeyPatch, place: Any, name: str, size: int
) -> None:
    small_recorder.add_topic(TWIST)
    monkeypatch.setattr(place, name, without_memory(getattr(place, name), 3))
    for number in range(1, 1001):
        small_recorder.commands(range(number, number + 1), size)
        if number % 20 == 0:
            small_recorder.settle()
    stats = small_recorder.close()
    assert (stats.received, stats.queued, stats.failure) == (1000, 0, "")
    assert stats.received == stats.written + stats.dropped
    assert stats.no_memory == stats.dropped < 500
    numbers = [message.sequence for message in read_strictly(stats.file)]
    assert len(numbers) == stats.written
    assert numbers[-1] == 1000
    assert numbers == sorted(set(numbers))


def test_without_any_memory_at_the_end_nothing_stays_queued(
    small_recorder: Tape, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PackBuffer, "take", without_memory(PackBuffer.take, 10**9))
    small_recorder.commands(range(1, 101))
    stats = small_recorder.close()
    assert (stats.written, stats.dropped, stats.queued) == (0, 100, 0)
    assert stats.state is RecorderState.CLOSED
    assert read_strictly(stats.file) == []


def test_the_thread_survives_a_failure_that_it_cannot_even_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Tape(tmp_path / "run", may_fail=True)
    monkeypatch.setattr(WriterThread, "_turn", without_memory(WriterThread._turn, 3))
    monkeypatch.setattr(WriterThread, "_fail", without_memory(WriterThread._fail, 2))
    until(lambda: recorder.stats().failure)
    recorder.commands(range(1, 11))
    stats = recorder.close()
    assert recorder.failures == [stats.failure]
    assert "MemoryError" in stats.failure
    assert stats.failure.endswith("; free memory")
    assert (stats.dropped, stats.queued) == (10, 0)


def test_a_message_that_is_packed_by_half_leaves_the_others_whole(small_recorder: Tape) -> None:
    channel = small_recorder.add_topic(TWIST)
    small_recorder.commands(range(1, 11))
    small_recorder.settle()
    small_recorder.commands(range(11, 12))

    class FullIndex(list[int]):
        def append(self, number: int) -> None:
            if len(self) % 2:
                raise MemoryError
            super().append(number)

    indexes: Any = small_recorder._buffer.indexes
    whole, indexes[channel] = indexes[channel], FullIndex()
    small_recorder.commands(range(12, 13))
    assert indexes[channel] == []
    indexes[channel] = whole
    small_recorder.commands(range(13, 20))
    stats = small_recorder.close()
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


def test_a_listener_that_raises_does_not_stop_the_counting(tmp_path: Path) -> None:
    def raise_it(text: str) -> None:
        raise RuntimeError(text)

    options = RecorderOptions(chunk_bytes=KIB, open_file=lambda path: FailingFile(path, 3))
    recorder = Recorder(tmp_path / "run", options, on_failure=raise_it)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 1001))
    stats = recorder.close()
    assert stats.state is RecorderState.FAILED
    assert_accounted(stats, 1000)
    assert stats.queued == 0


def test_the_memory_of_a_burst_is_given_back(tmp_path: Path) -> None:
    gate, recorder = gated(tmp_path / "run", 1024 * KIB)
    for burst in range(3):
        gate.clear()
        recorder.commands(range(burst * 6000 + 1, burst * 6000 + 6001))
        gate.set()
        recorder.settle()
        assert len(recorder._thread.spare) <= 2
    stats = recorder.close()
    assert (stats.written, stats.dropped) == (18_000, 0)


def test_a_folder_in_the_place_of_the_list_costs_no_message(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", may_fail=True)
    recorder.commands(range(1, 101))
    (tmp_path / "run" / "metadata.yaml").unlink()
    (tmp_path / "run" / "metadata.yaml").mkdir()
    stats = recorder.close()
    assert recorder.failures == [
        f"recording stopped: Is a directory ({stats.file}); check the disk and the folder"
    ]
    assert_accounted(stats, 100)
    assert_first_numbers(stats.file, 100)
