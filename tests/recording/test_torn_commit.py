"""A kill between any two writes of a commit leaves a file that every reader can open."""

from __future__ import annotations

import errno
import os
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pytest
from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex, Footer, Message, Statistics, SummaryOffset
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from robotctl.recording import Compression, RecorderOptions, Topic, read_messages
from robotctl.recording.format.disk import Buffer, DiskFile
from robotctl.recording.format.records import MAGIC
from robotctl.recording.keep.repair import repair
from robotctl.recording.read.records import RECORD_HEAD, parse, walk_records
from robotctl.recording.read.whole_data import FileState
from robotctl.recording.read.whole_file import SealState, WholeFile, read_whole_file
from robotctl.recording.write.bag_writer import RecordingFile
from robotctl.recording.write.buffer import pack
from robotctl.recording.write.channel_state import ChannelState
from robotctl.testing.drives import QOS
from robotctl.testing.faults import PAGE, FailingFile
from tests.support.recordings import keyring, numbered, read_strictly

COMMITS = 8
LARGE = 40_000


class Write(NamedTuple):
    """One positioned write; one without data cuts the file."""

    offset: int
    data: bytes


class LoggedFile(DiskFile):
    """A file that keeps all writes in a list."""

    def __init__(self, path: Path, writes: list[Write]) -> None:
        super().__init__(path)
        self.writes = writes

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        self.writes.append(Write(offset, b"".join(bytes(part) for part in parts)))
        super().write_at(parts, offset)

    def truncate(self, size: int) -> None:
        self.writes.append(Write(size, b""))
        super().truncate(size)


# Their definitions are short: the room for a new topic depends on the length.
TWIST = Topic("/cmd_vel", "geometry_msgs/msg/Twist", "Vector3 linear\n", "RIHS01_ab", QOS)
ODOMETRY = Topic("/odom", "nav_msgs/msg/Odometry", "Header header\n", "RIHS01_cd", QOS)


Commits = list[list[Write]]
"""The writes of each commit of a recording."""


def begin(
    folder: Path, compression: Compression, open_file: Callable[[Path], DiskFile]
) -> tuple[RecordingFile, list[ChannelState]]:
    folder.mkdir()
    keys = keyring(folder.with_name(f"{folder.name}-keys"))
    options = RecorderOptions(open_file=open_file, compression=compression, sealer=keys)
    channels = [ChannelState(TWIST)]
    file = RecordingFile(folder / f"{folder.name}_0.mcap", options, {}, channels)
    file.begin_seal()
    return file, channels


def write_commit(file: RecordingFile, channels: list[ChannelState], number: int, size: int) -> None:
    """Write a message of `size` random bytes and a small one; in the middle with a new topic."""
    if number == COMMITS // 2:
        channels.append(ChannelState(ODOMETRY))
    large = numbered(number) + random.Random(number).randbytes(size)
    small = (0, numbered(number), number, number, number)
    file.write(pack([small, (len(channels) - 1, large, number, 0, 0)]))


def record(folder: Path, size: int, compression: Compression) -> Commits:
    """Return a recording of COMMITS commits."""
    writes: list[Write] = []
    file, channels = begin(folder, compression, partial(LoggedFile, writes=writes))
    commits = [list(writes)]
    for number in range(1, COMMITS + 1):
        writes.clear()
        write_commit(file, channels, number, size)
        commits.append(list(writes))
    file.abandon()
    return commits


class Step(IntEnum):
    """The writes of a commit, counted from its last one; those from ROOM on make room."""

    TRAILER = 0
    HEAD = 1
    BODY = 2
    ROOM = 3
    MOVED_FOOTER = 4
    MOVED_TRAILER = 5
    DISTANT_FOOTER = 6
    CUT = 7
    TOPICS_HEAD = 8
    TOPICS = 9
    TRAILER_OF_TOPICS = 10


ROOM_WRITES = Step.CUT - Step.ROOM


def step_of(left: int) -> Step:
    """Return the step after which `left` writes are left; new topics may need room as well."""
    last = max(Step)
    room = range(last + 1, last + 1 + ROOM_WRITES)
    return Step(left - room.start + Step.ROOM) if left in room else Step(min(left, last))


class State(NamedTuple):
    """What a kill can leave: `chunks` were committed before, the write `step` is done or torn."""

    content: bytes
    chunks: int
    step: Step
    torn: bool


def states(recorded: Commits) -> Iterator[State]:
    """Yield each state between two writes, and torn states within each write."""
    dice = random.Random(4)
    content = bytearray()
    for chunks, commit in enumerate(recorded, start=-1):
        for number, write in enumerate(commit, start=1):
            step = step_of(len(commit) - number)
            to_page = PAGE - write.offset % PAGE
            cuts = [*range(to_page, len(write.data), PAGE)][-5:]
            cuts += dice.choices(range(len(write.data)), k=1 if write.data else 0)
            for cut in sorted(cuts):
                torn = put(bytearray(content), Write(write.offset, write.data[:cut]))
                yield State(bytes(torn), chunks, step, torn=True)
            put(content, write)
            yield State(bytes(content), chunks, step, torn=False)


def put(content: bytearray, write: Write) -> bytearray:
    end = write.offset + len(write.data)
    if not write.data:
        del content[end:]
    content.extend(bytes(max(end - len(content), 0)))
    content[write.offset : end] = write.data
    return content


def read_by_index(path: Path) -> list[bytes]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        found = [message.data for _, _, message in reader.iter_messages()]
        assert summary.statistics.message_count == len(found)
    return found


def read_as_stream(path: Path) -> list[bytes]:
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        return [record.data for record in records if isinstance(record, Message)]


def read_by_rosbags(path: Path) -> list[bytes]:
    with AnyReader([path]) as bag:
        return [bytes(data) for _, _, data in bag.messages()]


def read_by_ours(path: Path) -> list[bytes]:
    missing: list[str] = []
    found = [message.data for message in read_messages(path, on_missing=missing.append)]
    assert missing == []
    return found


def read_as_strictly_as_specified(path: Path) -> list[bytes]:
    """Check that the summary holds only what it may, and that each of its offsets is right."""
    data = path.read_bytes()
    footer_start = len(data) - len(MAGIC) - RECORD_HEAD.size - 20
    assert RECORD_HEAD.unpack_from(data, footer_start) == (Opcode.FOOTER, 20)
    assert data.endswith(MAGIC)
    footer = parse(Footer, data[footer_start + RECORD_HEAD.size : -len(MAGIC)])
    assert crc32(data[footer.summary_start : -len(MAGIC) - 4]) == footer.summary_crc
    summary = data[footer.summary_start : footer_start]
    counted = 0
    found: list[bytes] = []
    groups: dict[int, tuple[int, int]] = {}
    for opcode, start, end in walk_records(summary):
        content = summary[start:end]
        begin = footer.summary_start + start - RECORD_HEAD.size
        if opcode == Opcode.SUMMARY_OFFSET:
            offset = parse(SummaryOffset, content)
            assert groups.pop(offset.group_opcode) == (
                offset.group_start,
                offset.group_start + offset.group_length,
            )
            continue
        first, behind = groups.get(opcode, (begin, begin))
        assert behind == begin, "a group is torn apart"
        groups[opcode] = first, footer.summary_start + end
        if opcode == Opcode.STATISTICS:
            counted = parse(Statistics, content).message_count
        elif opcode == Opcode.CHUNK_INDEX:
            found += messages_of(data, parse(ChunkIndex, content))
    assert groups == {}
    assert counted == len(found)
    return found


def messages_of(data: bytes, entry: ChunkIndex) -> Iterator[bytes]:
    opcode, length = RECORD_HEAD.unpack_from(data, entry.chunk_start_offset)
    assert (opcode, length + RECORD_HEAD.size) == (Opcode.CHUNK, entry.chunk_length)
    for offset in entry.message_index_offsets.values():
        opcode, length = RECORD_HEAD.unpack_from(data, offset)
        assert opcode == Opcode.MESSAGE_INDEX
        yield from [b""] * ((length - 6) // 16)


BY_INDEX = (read_by_ours, read_by_index, read_by_rosbags)
AS_A_STREAM, STRICTLY = (read_as_stream,), (read_as_strictly_as_specified,)
TRAILERS = (Step.TRAILER,)
"""A kill within this leaves a torn file where it crosses a page."""

ENDS = (Step.DISTANT_FOOTER, Step.MOVED_FOOTER)
"""37 bytes: torn where they cross a page."""

HEADS = (Step.ROOM, Step.HEAD, Step.TOPICS_HEAD)
"""9 bytes: torn where they cross a page, if the kill comes in the microsecond between the two."""


def readers_of(state: State) -> tuple[Callable[[Path], list[bytes]], ...]:
    """Return the readers that can open what a kill in this state leaves."""
    if state.torn and state.step in TRAILERS + HEADS:
        return ()
    if state.torn and state.step in ENDS:
        return AS_A_STREAM
    if state.step in (Step.DISTANT_FOOTER, Step.MOVED_TRAILER):
        return BY_INDEX + AS_A_STREAM  # the summary lies far before its footer
    return BY_INDEX + AS_A_STREAM + STRICTLY


def opens(path: Path, readers: Sequence[Callable[[Path], list[bytes]]], chunks: int) -> None:
    """Check that each reader finds the messages of `chunks` chunks, or of one more."""
    for read in readers:
        assert len(read(path)) in (2 * chunks, 2 * chunks + 2), read.__name__


@pytest.mark.parametrize("compression", list(Compression))
def test_between_any_two_writes_of_a_commit_every_reader_opens_the_file(
    tmp_path: Path, compression: Compression
) -> None:
    recorded = record(tmp_path / "run", LARGE, compression)
    assert {len(commit) for commit in recorded[1:]} == {3, 7, 11}
    path = tmp_path / "state.mcap"
    for state in states(recorded):
        if state.chunks < 1:
            continue  # before the first chunk there is no index, and rosbags reads from the start
        path.write_bytes(state.content)
        opens(path, readers_of(state), state.chunks)


@pytest.mark.parametrize("size", [10, LARGE])
def test_what_a_kill_between_two_writes_leaves_is_no_flaw(tmp_path: Path, size: int) -> None:
    path = tmp_path / "state.mcap"
    for state in states(record(tmp_path / "run", size, Compression.ZSTD)):
        if state.chunks < 1 or state.torn:
            continue
        path.write_bytes(state.content)
        found = read_whole_file(path)
        assert found.whole, (state[1:], found.flaws.kept)
        assert found.data.message_count in (2 * state.chunks, 2 * state.chunks + 2)
        assert bool(found.loose) == (state.step is not Step.CUT), state.step  # the room
        assert found.seal.state is SealState.SEALED, state.step


@pytest.mark.parametrize("size", [10, LARGE])
def test_a_file_torn_within_any_write_is_read_and_repaired(tmp_path: Path, size: int) -> None:
    recorded = record(tmp_path / "run", size, Compression.NONE)
    path = tmp_path / "run" / "run_0.mcap"
    for state in states(recorded):
        if state.chunks < 0:
            continue  # the file does not exist yet
        path.write_bytes(state.content)
        found = list(read_messages(path, on_missing=lambda sentence: None))
        assert len(found) in (2 * state.chunks, 2 * state.chunks + 2), state[1:]
        assert [*repair(tmp_path)]
        if not found:
            continue  # it cannot be repaired
        assert len(read_strictly(path)) >= 2 * state.chunks, state[1:]


def test_a_read_that_fails_once_during_a_repair_loses_no_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = record(tmp_path / "run", LARGE, Compression.NONE)
    path = tmp_path / "run" / "run_0.mcap"
    reads, fail_at = 0, 0
    pread = os.pread

    def failing(fd: int, length: int, offset: int) -> bytes:
        nonlocal reads
        reads += 1
        if reads == fail_at:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return pread(fd, length, offset)

    monkeypatch.setattr("robotctl.recording.read.files.os.pread", failing)
    for state in states(recorded):
        if state.chunks != 2 or state.torn:
            continue
        path.write_bytes(state.content)
        reads, fail_at = 0, 0
        assert [*repair(tmp_path)]
        whole, count = len(read_strictly(path)), reads
        assert count > 20
        for at in range(1, count + 1):
            path.write_bytes(state.content)
            reads, fail_at = 0, at
            list(repair(tmp_path))
            fail_at = 0  # the next start
            list(repair(tmp_path))
            assert len(read_strictly(path)) == whole, (state.step, at)


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_at_any_write_of_a_commit_leaves_the_file_as_it_was(
    tmp_path: Path, code: int
) -> None:
    at = 8  # so many writes begin file, room and seal
    chunks = -1
    while chunks < COMMITS:
        at += 1
        folder = tmp_path / f"run{at}"
        disk = partial(FailingFile, fail_at=at, code=code, torn_bytes=4097)
        file, channels = begin(folder, Compression.NONE, disk)
        chunks = 0
        with suppress(OSError):
            while chunks < COMMITS:
                write_commit(file, channels, chunks + 1, LARGE)
                chunks += 1
        file.abandon()
        assert len(read_strictly(file.path)) == 2 * chunks, at
        assert len(read_as_strictly_as_specified(file.path)) == 2 * chunks, at
    assert at > 2 * COMMITS


def test_the_moment_of_danger_does_not_grow_with_the_messages(tmp_path: Path) -> None:
    exposed = {}
    for size in (LARGE, 10 * LARGE):
        recorded = record(tmp_path / f"run{size}", size, Compression.NONE)
        exposed[size] = [len(commit[-1 - Step.TRAILER].data) for commit in recorded[2:]]
    assert max(exposed[LARGE][:1]) < 900
    assert exposed[LARGE] == exposed[10 * LARGE]


def test_a_commit_writes_little_more_than_its_data_however_long_the_file(tmp_path: Path) -> None:
    writes: list[Write] = []
    file, channels = begin(tmp_path / "run", Compression.ZSTD, partial(LoggedFile, writes=writes))
    writes.clear()
    for number in range(2000):
        file.write(pack([(0, numbered(number), number, number, number)]))
    written = sum(len(write.data) for write in writes)
    assert file.size > 300_000
    assert written < 5 * file.size  # with a trailer that moves each time: 500
    assert len(channels) == 1
    file.finish()
    assert file.path.stat().st_size == file.size
    assert read_whole_file(file.path).whole


def test_a_growing_file_is_whole_after_each_write_of_a_commit(tmp_path: Path) -> None:
    found: list[WholeFile] = []

    class ReadFile(DiskFile):
        def __init__(self, path: Path) -> None:
            super().__init__(path)
            self._path = path

        def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
            super().write_at(parts, offset)
            if file is not None:
                found.append(read_whole_file(self._path))

    file: RecordingFile | None = None
    file, channels = begin(tmp_path / "run", Compression.ZSTD, ReadFile)
    for number in range(1, COMMITS // 2):
        write_commit(file, channels, number, LARGE)
    assert len(found) > 3 * 3
    for each in found:
        assert each.state is FileState.LIVE
        assert each.whole, each.flaws.kept
    counts = [each.data.message_count for each in found]
    assert counts == sorted(counts)
    assert counts[-1] == 2 * (COMMITS // 2 - 1)
    file.abandon()
