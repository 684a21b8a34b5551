"""Any MCAP file can be opened, alone or in a folder; what cannot be read is reported."""

from __future__ import annotations

import os
import random
import threading
from pathlib import Path

import pytest
from mcap.writer import CompressionType, IndexType, Writer

from robotctl.errors import UnreadableFile
from robotctl.recording import (
    Compression,
    Recorder,
    RecorderOptions,
    Recording,
    read_info,
    read_messages,
)
from robotctl.recording.disk.storage import DiskFile
from robotctl.recording.format.records import MAGIC
from robotctl.recording.read.indexing import index_of
from robotctl.recording.read.mcap_input import InputFile
from robotctl.testing.drives import ODOMETRY, TWIST
from tests.support.recordings import (
    first_numbers,
    foreign,
    numbered,
    recorded,
    salvaged,
    write_numbered,
)


@pytest.mark.parametrize("compression", list(Compression))
def test_our_own_recording_comes_back(tmp_path: Path, compression: Compression) -> None:
    recorder = Recorder(
        tmp_path / "run", RecorderOptions(compression=compression), on_failure=pytest.fail
    )
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
        with (tmp_path / f"bag_{part}.mcap").open("wb") as stream:
            writer = Writer(stream, chunk_size=2048)
            writer.start()
            channel = writer.register_channel("/a", "cdr", 0)
            for number in numbers[part::2]:
                writer.add_message(channel, number // 2, numbered(number), 0, number)
            writer.finish()
    times = [message.log_ns for message in read_messages(tmp_path)]
    assert times == sorted(times)
    assert len(times) == 2000


def test_split_files_are_read_in_their_natural_order(tmp_path: Path) -> None:
    for part in (0, 2, 10):
        foreign(tmp_path / f"run_{part}.mcap", 1)
    assert [path.name for path in read_info(tmp_path).files] == [
        "run_0.mcap",
        "run_2.mcap",
        "run_10.mcap",
    ]


def test_a_damaged_file_of_a_folder_does_not_hide_the_others(tmp_path: Path) -> None:
    foreign(tmp_path / "run_0.mcap", 10)
    (tmp_path / "run_1.mcap").write_bytes(b"")
    foreign(tmp_path / "run_2.mcap", 5)
    info = read_info(tmp_path)
    assert info.message_count == 15
    assert info.missing == ("run_1.mcap: it is empty",)


def test_a_recording_is_readable_while_it_grows(tmp_path: Path) -> None:
    options = RecorderOptions(chunk_bytes=512, flush_s=0.001)
    recorder = Recorder(tmp_path / "run", options, on_failure=pytest.fail)
    channel = recorder.add_topic(TWIST)
    stop = threading.Event()

    def write() -> None:
        number = 0
        while not stop.is_set():
            number += 1
            write_numbered(recorder, channel, range(number, number + 1))
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


@pytest.mark.parametrize(
    "text", ["", "[" * 5000, "\0", "relative_file_paths: 7", "relative_file_paths:\n"]
)
def test_a_damaged_metadata_yaml_does_not_hide_the_messages(tmp_path: Path, text: str) -> None:
    recorded(tmp_path / "run", 10)
    (tmp_path / "run" / "metadata.yaml").write_text(text)
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing) == (10, ())


def test_what_is_no_file_in_a_folder_does_not_block(tmp_path: Path) -> None:
    recorded(tmp_path / "run", 10)
    os.mkfifo(tmp_path / "run" / "pipe.mcap")
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing) == (10, ("pipe.mcap: it is not a regular file",))


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


def test_progress_is_told_while_scanning(tmp_path: Path) -> None:
    path = foreign(tmp_path / "cut.mcap", 500)
    path.write_bytes(path.read_bytes()[:-20])
    steps: list[tuple[int, int]] = []
    Recording(path, on_progress=lambda done, total: steps.append((done, total))).close()
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    assert steps[-1][1] == path.stat().st_size


def test_a_file_that_was_empty_when_it_was_opened_is_read_as_it_is_by_now(tmp_path: Path) -> None:
    content = recorded(tmp_path / "run", 10).read_bytes()
    path = tmp_path / "split.mcap"
    writer = DiskFile(path)
    with InputFile(path) as file:
        writer.write_at([content], 0)
        assert index_of(file).message_count == 10
    writer.close()
