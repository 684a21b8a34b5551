"""Any MCAP file can be opened, alone or in a folder; what cannot be read is reported.

A part of a recording is read without the parts before and after it.
The journal of the recording robot is found among others, and read in the order of writing.
A recording that is no local file: a check reads the ranges that it needs, and few of them.
"""

from __future__ import annotations

import errno
import os
import random
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType

from robotctl.base.errors import UnreadableFile
from robotctl.base.store import path_of
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording
from robotctl.messages.cdr import JOURNAL_ENTRY
from robotctl.recording import (
    Compression,
    Message,
    Recorder,
    RecorderOptions,
    Recording,
    Topic,
    read_info,
    read_messages,
)
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode, encode
from robotctl.recording.format.records import MAGIC
from robotctl.recording.read.journal_reader import journal_topic, read_journal
from robotctl.recording.read.records import InputFile
from robotctl.testing.drives import GID, JOURNAL, ODOMETRY, START_NS, TWIST, drive, record
from tests.support.cases import for_each
from tests.support.recordings import (
    Tape,
    by_mcap,
    first_numbers,
    foreign,
    numbered,
    recorded,
    salvaged,
    write_numbered,
)
from tests.support.stores import StoredFile, serving


@pytest.mark.parametrize("compression", list(Compression))
def test_our_own_recording_comes_back(tmp_path: Path, compression: Compression) -> None:
    recorder = Tape(tmp_path / "run", compression=compression)
    twist, odometry = recorder.add_topic(TWIST), recorder.add_topic(ODOMETRY)
    write_numbered(recorder, twist, range(1, 101))
    write_numbered(recorder, odometry, range(1, 51))
    recorder.close()
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing, info.indexed) == (150, (), True)
    assert info.duration_s == pytest.approx(0.099)
    topics = {topic.name: topic for topic in info.topics}
    assert topics["/cmd_vel"].message_count == 100
    assert topics["/cmd_vel"].rate_hz == pytest.approx(100 / 0.099)
    assert topics["/odom"].type_name == "nav_msgs/msg/Odometry"
    assert topics["/odom"].offered_qos == ODOMETRY.offered_qos
    assert topics["/odom"].type_hash == ODOMETRY.type_hash
    assert topics["/odom"].definition == ODOMETRY.definition
    assert set(info.metadata) == {"robotctl", "rosbag2", "robotctl.ledger"}
    messages = list(read_messages(tmp_path / "run", topics={"/odom"}))
    assert [m.data for m in messages] == first_numbers(50)
    assert {(m.topic, m.type_name) for m in messages} == {("/odom", "nav_msgs/msg/Odometry")}
    assert messages[0].publish_ns == messages[0].log_ns - 500


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.ZSTD},
        {"use_chunking": False},
        {"index_types": IndexType.NONE},
        {"use_statistics": False},
        {"use_summary_offsets": False, "repeat_channels": False, "repeat_schemas": False},
        {"enable_crcs": False},
    ],
    ids=str,
)
def test_files_of_other_writers_come_back(tmp_path: Path, options: dict[str, object]) -> None:
    path = foreign(tmp_path / "other.mcap", 500, **options)
    info = read_info(path)
    assert (info.message_count, info.missing) == (500, ())
    assert [m.data for m in read_messages(path)] == first_numbers(500)


def test_messages_come_in_the_order_of_their_log_time_over_all_files(tmp_path: Path) -> None:
    dice = random.Random(4)
    numbers = list(range(1, 2001))
    dice.shuffle(numbers)
    for part in range(2):
        messages = [("/a", number // 2, numbered(number)) for number in numbers[part::2]]
        by_mcap(tmp_path / f"bag_{part}.mcap", messages, chunk_size=2048)
    times = [message.log_ns for message in read_messages(tmp_path)]
    assert times == sorted(times)
    assert len(times) == 2000


def test_the_files_of_a_folder_are_read_in_their_natural_order_and_damage_hides_no_other(
    tmp_path: Path,
) -> None:
    for part in (0, 2, 10):
        foreign(tmp_path / f"run_{part}.mcap", 5)
    assert [path.name for path in read_info(tmp_path).files] == [
        "run_0.mcap",
        "run_2.mcap",
        "run_10.mcap",
    ]
    (tmp_path / "run_1.mcap").write_bytes(b"")
    os.mkfifo(tmp_path / "run_3.mcap")
    info = read_info(tmp_path)
    assert info.message_count == 15
    assert info.missing == ("run_1.mcap: it is empty", "run_3.mcap: it is not a regular file")


def test_a_recording_is_readable_while_it_grows(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", chunk_bytes=512, flush_s=0.001)
    stop = threading.Event()

    def write() -> None:
        number = 0
        while not stop.is_set():
            number += 1
            recorder.commands(range(number, number + 1))
            stop.wait(0.0002)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        for _ in range(50):
            messages, missing = salvaged(recorder.stats().file)
            assert not missing
            assert [m.data for m in messages] == first_numbers(len(messages))
    finally:
        stop.set()
        thread.join()
        recorder.close()


def test_reading_of_what_is_missing_ends_in_the_one_error(tmp_path: Path) -> None:
    path = foreign(tmp_path / "cut.mcap", 500)
    path.write_bytes(path.read_bytes()[:8000])
    messages, missing = salvaged(path)
    assert len(messages) > 50
    iterator = read_messages(path)
    assert [next(iterator) for _ in messages] == messages
    with pytest.raises(UnreadableFile, match=r"is incomplete: bytes .* are lost") as caught:
        next(iterator)
    assert "\n" not in str(caught.value)
    assert missing[0] in str(caught.value)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "it is empty"),
        (bytes(100_000), "begins with zeros"),
        (b"\x89MCA", "it is not an MCAP file"),
        (b"SQLite format 3\0" * 10, "it is not an MCAP file"),
        (MAGIC, "in the middle of a record"),
        (MAGIC + b"\x01" + (2**63).to_bytes(8, "little"), "claims 9223372036854775808 bytes"),
        (MAGIC + b"\x05" + bytes(40), "does not begin with a header"),
        (MAGIC + b"\x01" + (9).to_bytes(8, "little") + b"\xff" * 9, "record is malformed"),
    ],
)
def test_a_file_with_nothing_to_read_is_named_in_one_sentence(
    tmp_path: Path, content: bytes, reason: str
) -> None:
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    with pytest.raises(UnreadableFile, match=reason) as caught:
        read_info(path)
    assert str(path) in str(caught.value)
    with pytest.raises(UnreadableFile):
        list(read_messages(path))


def test_a_file_that_the_bag_names_and_that_is_not_there_is_missing(tmp_path: Path) -> None:
    file = recorded(tmp_path / "run", 10)
    foreign(tmp_path / "run" / "more.mcap", 5)
    file.unlink()
    info = read_info(tmp_path / "run")
    assert info.message_count == 5
    assert info.missing == ("run_0.mcap: metadata.yaml names it, but it is not there",)


def test_a_file_whose_name_is_a_hash_hides_no_other(tmp_path: Path) -> None:
    foreign(tmp_path / "run.mcap", 5)
    (tmp_path / ("a" * 64)).touch()
    assert read_info(tmp_path).message_count == 5


def test_what_is_no_recording_is_named_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for path, reason in [
        (tmp_path / "nothing", "No such file"),
        (tmp_path / "empty", "holds no .mcap file"),
        (Path("/dev/null"), "is not a file"),
        (Path("a\0b"), "cannot be read"),
        (tmp_path / ("x" * 5000), "File name too long"),
    ]:
        with pytest.raises(UnreadableFile, match=reason):
            read_info(path)


TOPICS = ("/a", "/b", "/map")

written = st.lists(st.tuples(st.sampled_from(TOPICS), st.integers(0, 30)), max_size=40)
moments = st.integers(0, 31)
"""Log times collide and run backwards, and chunks overlap."""


def write(path: Path, messages: list[tuple[str, int]], **options: Any) -> Path:
    """Write a file with chunks of about three messages."""
    told = [(topic, at_ns, numbered(n, 48)) for n, (topic, at_ns) in enumerate(messages)]
    return by_mcap(path, told, chunk_size=200, **options)


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


def record_journals(folder: Path, robot: str, topics: dict[str, Iterable[int]]) -> Path:
    """Return a recording of journals whose entries have these log times after START_NS."""
    recorder = Tape(folder, chunk_bytes=1024, metadata=lambda: {"robot": robot})
    recorder.add_topic(TWIST)
    for name, times in topics.items():
        channel = recorder.add_topic(Topic(name, JOURNAL_ENTRY))
        for seq, time_ns in enumerate(times):
            entry = encode(JournalEntry(seq, seq, EntryKind.EVENT, "Tick", name))
            recorder.write(channel, entry, START_NS + time_ns, START_NS, seq + 1, GID)
    recorder.close()
    return folder


@pytest.mark.parametrize(
    ("robot", "topics", "found"),
    [
        ("robot", ["/robotctl/journal"], "/robotctl/journal"),
        ("r2", ["/robotctl/journal", "/r2/robotctl/journal"], "/r2/robotctl/journal"),
        ("robot", ["/robotctl/journal", "/r2/robotctl/journal"], "/robotctl/journal"),
        ("robot", ["/renamed"], "/renamed"),
        ("robot", ["/a", "/b"], None),
        ("robot", [], None),
    ],
)
def test_the_journal_is_that_of_the_robot_that_recorded(
    tmp_path: Path, robot: str, topics: list[str], found: str | None
) -> None:
    folder = record_journals(tmp_path / "run", robot, {name: [1] for name in topics})
    with Recording(folder) as recording:
        assert journal_topic(recording.info()) == found
        if found:
            assert {each.entry.data for each in read_journal(recording, pytest.fail)} == {found}
        else:
            with pytest.raises(UnreadableFile, match="holds no journal"):
                next(read_journal(recording, pytest.fail))


def test_entries_come_as_they_were_written_though_the_clock_was_set_back(tmp_path: Path) -> None:
    times = [*range(5000, 5400), *range(100, 500), *range(5100, 5200)]
    with Recording(
        record_journals(tmp_path / "run", "robot", {"/robotctl/journal": times})
    ) as recording:
        read = list(read_journal(recording, pytest.fail))
    assert [each.entry.seq for each in read] == list(range(900))
    assert [each.log_ns - START_NS for each in read] == times


@for_each(
    ("at", "byte", "says"),
    [
        (24, 0, "it has no name or kind"),
        (25, 1, "its name has 261 bytes, more than 255"),
        (20, 3, "it has no name or kind"),
        (1, 7, "not little-endian CDR"),
    ],
)
def test_an_entry_with_a_damaged_head_is_told(at: int, byte: int, says: str) -> None:
    damaged = bytearray(encode(JournalEntry(1, 2, EntryKind.EVENT, "Tick", "{}")))
    damaged[at] = byte
    with pytest.raises(UnreadableFile, match=says):
        decode(bytes(damaged))


def test_a_name_that_no_entry_can_hold_is_refused() -> None:
    with pytest.raises(KeyError):
        encode(JournalEntry(1, 2, EntryKind.EVENT, "x" * 255, "{}"))


CAMERA = Topic("/camera", "sensor_msgs/msg/CompressedImage")
IMAGE = random.Random(1).randbytes(300_000)
EVERY_NS = 33_000_000
EVIDENCE = frozenset({JOURNAL.name, TWIST.name, ODOMETRY.name})


class CountingSource:
    """A source that is no local file: it counts the bytes, and may be out of reach."""

    def __init__(self, path: Path, *, in_reach: bool = True) -> None:
        self._content = path.read_bytes()
        self._in_reach = in_reach
        self.sent = 0

    def size(self) -> int:
        if not self._in_reach:
            raise ConnectionRefusedError(errno.ECONNREFUSED, os.strerror(errno.ECONNREFUSED))
        return len(self._content)

    stored_bytes = size

    def read(self, offset: int, length: int) -> bytes:
        self.sent += length
        return self._content[offset : offset + length]

    def is_written(self) -> bool:
        return False

    def close(self) -> None:
        """Do nothing."""


def camera() -> Callable[[Recorder, int], None]:
    """Return what records an image each 33 ms."""
    due_ns = 0

    def beside(recorder: Recorder, time_ns: int) -> None:
        nonlocal due_ns
        while due_ns <= time_ns:
            recorder.write(recorder.add_topic(CAMERA), IMAGE, time_ns, time_ns, 0, GID)
            due_ns = max(due_ns, time_ns) + EVERY_NS

    return beside


@pytest.fixture(scope="module")
def camera_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a drive of 20 s beside a camera."""
    folder = tmp_path_factory.mktemp("camera") / "run"
    options = RecorderOptions(evidence=EVIDENCE, memory_bytes=1 << 30)
    record(folder, drive(20.0, snapshots_s=(0.0, 10.0)), options=options, beside=camera())
    (file,) = folder.glob("*.mcap")
    return file


def test_a_check_of_another_source_says_what_a_check_of_the_file_says_and_reads_little(
    camera_file: Path,
) -> None:
    """This one has 20 s; with the minutes of a real one, the share of the index gets smaller."""
    source = CountingSource(camera_file)
    report = check_recording(Path("remote.mcap"), source=source)
    local = check_recording(camera_file)
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert (report.events, report.effects, report.commands) == (
        local.events,
        local.effects,
        local.commands,
    )
    assert "not every byte was read, only what the check needs" in report.notes
    assert source.sent < 0.01 * camera_file.stat().st_size


def test_a_check_of_a_file_at_a_url_reads_a_small_part_of_it(
    camera_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with serving(monkeypatch) as bucket:
        bucket.objects["run.mcap"] = StoredFile(camera_file)
        report = check_recording(path_of("s3://robots/run.mcap"))
    assert (report.verdict, report.missing) == (Verdict.SAME, [])
    assert bucket.sent_bytes < 0.1 * camera_file.stat().st_size


def test_a_source_that_is_out_of_reach_cannot_be_read(camera_file: Path) -> None:
    source = CountingSource(camera_file, in_reach=False)
    assert check_recording(Path("remote.mcap"), source=source).verdict is Verdict.INCOMPLETE


@pytest.mark.parametrize(
    "text", ["", "[" * 5000, "\0", "relative_file_paths: 7", "relative_file_paths:\n"]
)
def test_a_damaged_metadata_yaml_does_not_hide_the_messages(tmp_path: Path, text: str) -> None:
    recorded(tmp_path / "run", 10)
    (tmp_path / "run" / "metadata.yaml").write_text(text)
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing) == (10, ())
