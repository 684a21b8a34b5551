"""Any MCAP file opens; what cannot be read is said; nothing is made up."""

from __future__ import annotations

import os
import random
import struct
import threading
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from shutil import copyfile, copytree

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Header,
    McapRecord,
    Metadata,
    Schema,
    Statistics,
)
from mcap.writer import CompressionType, IndexType, Writer

from robotctl.errors import UnreadableFile
from robotctl.recording.mcap_file import MAGIC, MESSAGE_HEAD
from robotctl.recording.mcap_input import Damaged, parse
from robotctl.recording.reader import Message, Recording, read_info, read_messages
from robotctl.recording.recorder import Compression, Recorder, RecorderOptions
from robotctl.testing.mcap_faults import mutated, record_boundaries
from robotctl.testing.recordings import (
    ODOMETRY,
    START_NS,
    TWIST,
    number_of,
    numbered,
    write_numbered,
)

SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "rosbag2"
needs_samples = pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"no sample bags at {SAMPLES}")


def recorded(folder: Path, count: int, **options: object) -> Path:
    """A recording of ours with `count` messages in chunks of about 1 KiB."""
    options = {"chunk_bytes": 1024, **options}
    recorder = Recorder(folder, RecorderOptions(**options), on_failure=pytest.fail)  # type: ignore[arg-type]
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, count + 1))
    return recorder.close().file


def foreign(path: Path, count: int, **options: object) -> Path:
    """A file by the mcap package's writer, with chunks of about 1 KiB."""
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 1024, **options})  # type: ignore[arg-type]
        writer.start(profile="ros2", library="somebody")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/cmd_vel", "cdr", schema)
        for number in range(1, count + 1):
            stamp = START_NS + number * 1_000_000
            writer.add_message(channel, stamp, numbered(number), stamp, number)
        writer.finish()
    return path


def salvaged(path: Path) -> tuple[list[Message], list[str]]:
    missing: list[str] = []
    return list(read_messages(path, on_missing=missing.append)), missing


def first_numbers(count: int) -> list[bytes]:
    return [numbered(number) for number in range(1, count + 1)]


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
        (b"\x89MCA", "it is no MCAP file"),
        (b"SQLite format 3\0" * 10, "it is no MCAP file"),
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


@needs_samples
def test_a_file_that_rosbag2_names_and_that_is_not_there_is_missing(tmp_path: Path) -> None:
    copytree(SAMPLES / "split_bag", tmp_path / "bag", copy_function=copyfile)
    (tmp_path / "bag").chmod(0o755)
    (tmp_path / "bag" / "wbag_3.mcap").unlink()
    assert read_info(tmp_path / "bag").missing == (
        "wbag_3.mcap: metadata.yaml names it, but it is not there",
    )


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
    assert (info.message_count, info.missing) == (10, ("pipe.mcap: it is no regular file",))


def test_what_is_no_recording_is_named_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for path, reason in [
        (tmp_path / "nothing", "No such file"),
        (tmp_path / "empty", "holds no .mcap file"),
        (Path("/dev/null"), "is no file"),
        (Path("a\0b"), "cannot be read"),
        (tmp_path / ("x" * 5000), "File name too long"),
    ]:
        with pytest.raises(UnreadableFile, match=reason):
            read_info(path)


def complete_prefix(data: bytes, length: int) -> int:
    """How many messages the chunks hold that lie within the first `length` bytes."""
    count = 0
    for offset in record_boundaries(data):
        opcode, size = struct.unpack_from("<BQ", data, offset)
        if opcode == Opcode.MESSAGE_INDEX:
            continue
        if offset + 9 + size > length or opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            uncompressed, _, name = struct.unpack_from("<QII", data, offset + 9 + 16)
            count += uncompressed // (MESSAGE_HEAD.size + 52)
            assert name in (0, 4)
    return count


def cuts(data: bytes, dice: random.Random) -> list[int]:
    at_records = {offset + shift for offset in record_boundaries(data) for shift in (-1, 0, 1)}
    return sorted(at_records | set(dice.choices(range(len(data)), k=300)))


@pytest.mark.parametrize("compression", list(Compression))
def test_a_truncated_file_gives_its_full_prefix(tmp_path: Path, compression: Compression) -> None:
    data = recorded(tmp_path / "run", 300, compression=compression).read_bytes()
    header_end = list(record_boundaries(data))[1]
    path = tmp_path / "cut.mcap"
    for cut in cuts(data, random.Random(5)):
        path.write_bytes(data[:cut])
        if cut < header_end:
            with pytest.raises(UnreadableFile):
                read_info(path)
            continue
        messages, missing = salvaged(path)
        assert [m.data for m in messages] == first_numbers(complete_prefix(data, cut)), cut
        info = read_info(path)
        assert info.message_count == len(messages)
        assert bool(missing) == (cut < len(data) - len(MAGIC)), cut
        assert list(info.missing) == missing


@pytest.mark.slow
def test_a_file_truncated_at_each_of_its_last_64_kib_gives_its_full_prefix(tmp_path: Path) -> None:
    options = {"compression": Compression.NONE, "chunk_bytes": 4096}
    data = recorded(tmp_path / "run", 800, **options).read_bytes()
    path = tmp_path / "cut.mcap"
    for cut in range(len(data) - (64 << 10), len(data)):
        path.write_bytes(data[:cut])
        messages, _ = salvaged(path)
        assert [m.data for m in messages] == first_numbers(complete_prefix(data, cut)), cut


def test_a_cut_chunk_of_a_writer_that_only_appends_is_read_up_to_the_cut(tmp_path: Path) -> None:
    path = foreign(tmp_path / "cut.mcap", 1000, compression=CompressionType.NONE, chunk_size=10**9)
    data = path.read_bytes()
    for cut in random.Random(6).choices(range(2000, 80_000), k=50):
        path.write_bytes(data[:cut])
        messages, missing = salvaged(path)
        assert len(messages) in range((cut - 400) // 83, cut // 83 + 1)
        assert [m.data for m in messages] == first_numbers(len(messages))
        assert missing


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_cut_compressed_chunk_is_read_as_far_as_it_unpacks(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = tmp_path / "cut.mcap"
    dice = random.Random(7)
    sent = [dice.randbytes(1000) for _ in range(2000)]
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=10**9, compression=compression)
        writer.start()
        channel = writer.register_channel("/a", "cdr", 0)
        for number, data in enumerate(sent):
            writer.add_message(channel, number, data, number)
        writer.finish()
    path.write_bytes(path.read_bytes()[:1_000_000])
    messages, missing = salvaged(path)
    assert len(messages) > (500 if compression is CompressionType.ZSTD else -1)
    assert [m.data for m in messages] == sent[: len(messages)]
    assert missing


@pytest.mark.parametrize("summary", [True, False])
def test_one_damaged_chunk_costs_that_chunk_only(tmp_path: Path, summary: bool) -> None:
    path = recorded(tmp_path / "run", 1000)
    data = bytearray(path.read_bytes())
    chunks = [offset for offset in record_boundaries(bytes(data)) if data[offset] == Opcode.CHUNK]
    data[chunks[10] + 80] ^= 0xFF
    path.write_bytes(data if summary else data[:-40])
    messages, missing = salvaged(path)
    lost = set(range(1, 1001)) - {number_of(m.data) for m in messages}
    per_chunk = 1024 // 83
    assert lost == set(range(10 * per_chunk + 1, 11 * per_chunk + 1))
    assert len(missing) == (1 if summary else 2)


@pytest.mark.parametrize("write", [recorded, lambda path, n: foreign(path.with_suffix(".m"), n)])
@pytest.mark.parametrize("garbage", [bytes(500), b"\x06" * 500, b"\xff" * 500])
def test_after_a_piece_of_nonsense_the_next_chunk_is_found(
    tmp_path: Path, write: Callable[[Path, int], Path], garbage: bytes
) -> None:
    path = write(tmp_path / "run", 1000)
    whole = path.read_bytes()
    chunks = [offset for offset in record_boundaries(whole) if whole[offset] == Opcode.CHUNK]
    data = bytearray(whole[:-30])
    data[chunks[10] : chunks[10] + 500] = garbage
    path.write_bytes(data)
    messages, missing = salvaged(path)
    numbers = [number_of(m.data) for m in messages]
    assert 960 < len(numbers) < 1000
    assert numbers == sorted(set(numbers))
    assert f"bytes {chunks[10]} to" in missing[0]


def test_nonsense_without_end_is_searched_in_bounded_time(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", 100)
    head = b"\x06" + bytes(12)
    path.write_bytes(path.read_bytes()[:3000] + head * 500_000)
    messages, missing = salvaged(path)
    assert 0 < len(messages) < 100
    assert missing


def test_our_own_files_hold_no_messages_outside_chunks(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", 300)
    data = bytearray(path.read_bytes())
    for offset in record_boundaries(path.read_bytes()):
        if data[offset] == Opcode.MESSAGE_INDEX:
            data[offset] = Opcode.MESSAGE
    path.write_bytes(data[:-30])
    messages, missing = salvaged(path)
    assert [number_of(m.data) for m in messages] == list(range(1, 301))
    assert missing


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        (
            Schema,
            struct.pack("<H", 1) + b"\1\0\0\0a" + b"\1\0\0\0b" + struct.pack("<I", 99) + b"abc",
        ),
        (Channel, struct.pack("<HH", 1, 1) + b"\1\0\0\0a" + b"\1\0\0\0b" + b"\x09\0\0\0"),
        (Metadata, b"\xff\xff\xff\xffname"),
        (Statistics, b"\0" * 20),
        (Header, b"\1\0\0\0\xff" + b"\0\0\0\0"),
        (ChunkIndex, b"\xff" * 60),
    ],
)
def test_a_record_that_promises_more_than_it_holds_is_damaged(
    kind: type[McapRecord], content: bytes
) -> None:
    with pytest.raises(Damaged, match="record is malformed"):
        parse(kind, content)


def test_what_is_missing_is_said_in_few_words(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run", 2000)
    whole = path.read_bytes()
    data = bytearray(whole)
    for offset in record_boundaries(whole):
        if whole[offset] == Opcode.CHUNK:
            data[offset + 80] ^= 0xFF
    for content in (data, data[:-30]):
        path.write_bytes(content)
        messages, missing = salvaged(path)
        assert messages == []
        assert len(read_info(path).missing) <= 21
        with pytest.raises(UnreadableFile, match="and more") as caught:
            list(read_messages(path))
        assert len(str(caught.value)) < 3000
    assert missing


def test_messages_without_a_described_channel_are_counted_as_missing(tmp_path: Path) -> None:
    data = recorded(tmp_path / "run", 24).read_bytes()
    boundaries = list(record_boundaries(data))
    channel = next(offset for offset in boundaries if data[offset] == Opcode.CHANNEL)
    end = boundaries[boundaries.index(channel) + 1]
    data_end = next(offset for offset in boundaries if data[offset] == Opcode.DATA_END)
    path = tmp_path / "bad.mcap"
    path.write_bytes(data[:channel] + data[end:data_end])
    info = read_info(path)
    assert info.message_count == 0
    assert "24 messages are lost: their channel is described nowhere" in info.missing


def test_fuzzed_files_give_one_error_or_true_messages(tmp_path: Path) -> None:
    fuzz(tmp_path, 1000)


@pytest.mark.slow
def test_ten_thousand_fuzzed_files_give_one_error_or_true_messages(tmp_path: Path) -> None:
    fuzz(tmp_path, 10_000)


def fuzz(folder: Path, rounds: int) -> None:
    dice = random.Random(8)
    files = [
        recorded(folder / "zstd", 300, compression=Compression.ZSTD).read_bytes(),
        recorded(folder / "none", 300, compression=Compression.NONE).read_bytes(),
        foreign(folder / "zstd.mcap", 300).read_bytes(),
        foreign(folder / "lz4.mcap", 300, compression=CompressionType.LZ4).read_bytes(),
    ]
    true = set(first_numbers(300))
    path = folder / "fuzzed.mcap"
    refusals: list[str] = []
    for _ in range(rounds):
        path.write_bytes(mutated(dice.choice(files), dice))
        try:
            info = read_info(path)
            messages, missing = salvaged(path)
        except UnreadableFile as error:
            refusals.append(str(error))
            continue
        assert {message.data for message in messages} <= true
        assert len(messages) >= 300 or missing or info.missing
    assert len(refusals) < rounds // 2
    assert not any("\n" in refusal for refusal in refusals)


def crafted(chunk: bytes) -> bytes:
    """A file of somebody's whose only chunk has this content."""
    header = b"\x01" + (8).to_bytes(8, "little") + bytes(8)
    return MAGIC + header + b"\x06" + len(chunk).to_bytes(8, "little") + chunk


def chunk_content(
    compression: bytes, size: int, data: bytes, data_size: int | None = None
) -> bytes:
    return (
        struct.pack("<QQQII", 0, 1, size, 0, len(compression))
        + compression
        + (len(data) if data_size is None else data_size).to_bytes(8, "little")
        + data
    )


def zeros(size: int, compress: Callable[[], zstandard.ZstdCompressionObj]) -> bytes:
    stream = compress()
    block = bytes(1 << 20)
    return b"".join([*(stream.compress(block) for _ in range(size >> 20)), stream.flush()])


GIB = 1 << 30


@pytest.mark.parametrize(
    "content",
    [
        lambda: chunk_content(b"zstd", 2**63, b"x"),
        lambda: chunk_content(b"zstd", 100, zeros(GIB, zstandard.ZstdCompressor().compressobj)),
        lambda: chunk_content(
            b"zstd", GIB, zeros(GIB, lambda: zstandard.ZstdCompressor().compressobj(size=GIB))
        ),
        lambda: chunk_content(
            b"zstd", 100, zeros(GIB, lambda: zstandard.ZstdCompressor().compressobj(size=GIB))
        ),
        lambda: chunk_content(b"lz4", 2**62, lz4.frame.compress(bytes(1000))),
        lambda: chunk_content(b"lz4", 100, lz4.frame.compress(bytes(GIB // 8))),
        lambda: chunk_content(b"", 2**40, b"", 2**40),
        lambda: chunk_content(b"", 100, b"", 2**64 - 1),
        lambda: chunk_content(b"rar", 100, b"x" * 100),
        lambda: chunk_content(b"\xff" * 20, 100, b"x" * 100),
        lambda: struct.pack("<QQQII", 0, 1, 5, 0, 2**32 - 1),
        lambda: b"short",
    ],
)
def test_what_claims_to_be_huge_is_refused_before_memory_is_taken(
    tmp_path: Path, content: Callable[[], bytes]
) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(crafted(content()))
    tracemalloc.start()
    try:
        info = read_info(path)
        messages, missing = salvaged(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (info.message_count, messages) == (0, [])
    assert missing == list(info.missing) != []
    assert peak < 16 << 20


def test_chunks_that_all_overlap_are_not_all_held_in_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.recording.merge.MAX_OPEN_BYTES", 10_000)
    path = tmp_path / "overlap.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=3000)
        writer.start()
        channel = writer.register_channel("/a", "cdr", 0)
        for number in range(1000):
            writer.add_message(channel, number % 20, numbered(number), 0)
        writer.finish()
    messages, missing = salvaged(path)
    assert 100 < len(messages) < 1000
    assert any("too many chunks overlap in time" in sentence for sentence in missing)


def test_progress_is_told_while_scanning(tmp_path: Path) -> None:
    path = foreign(tmp_path / "cut.mcap", 500)
    path.write_bytes(path.read_bytes()[:-20])
    steps: list[tuple[int, int]] = []
    Recording(path, on_progress=lambda done, total: steps.append((done, total))).close()
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    assert steps[-1][1] == path.stat().st_size


@needs_samples
@pytest.mark.parametrize(
    ("name", "count", "topics"),
    [
        ("talker", 20, {"/rosout", "/parameter_events", "/topic"}),
        ("split_bag", 6074, {letter * 3 for letter in "ABCDEFGH"}),
        (
            "bag_with_topics_and_service_events",
            10,
            {
                "/test_topic1",
                "/test_topic2",
                "/test_service1/_service_event",
                "/test_service2/_service_event",
                "/events/write_split",
            },
        ),
        ("cdr_test", 7, {"/test_topic", "/array_topic"}),
    ],
)
def test_bags_of_rosbag2_open(name: str, count: int, topics: set[str]) -> None:
    info = read_info(SAMPLES / name)
    assert (info.message_count, info.missing, info.profile) == (count, (), "ros2")
    assert {topic.name for topic in info.topics} <= topics
    assert {topic.name for topic in info.topics if topic.message_count} <= topics
    messages = list(read_messages(SAMPLES / name))
    assert len(messages) == count
    times = [message.log_ns for message in messages]
    assert times == sorted(times)
    assert (times[0], times[-1]) == (info.start_ns, info.end_ns)


@needs_samples
def test_truncated_bags_of_rosbag2_give_true_messages(tmp_path: Path) -> None:
    dice = random.Random(9)
    for source in sorted(SAMPLES.glob("*/*.mcap")):
        whole = [(m.topic, m.data, m.log_ns) for m in read_messages(source)]
        data = source.read_bytes()
        path = tmp_path / "cut.mcap"
        for cut in dice.choices(range(200, len(data)), k=40):
            path.write_bytes(data[:cut])
            messages, missing = salvaged(path)
            assert {(m.topic, m.data, m.log_ns) for m in messages} <= set(whole)
            assert missing or len(messages) == len(whole)
