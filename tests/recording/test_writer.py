"""Messages can be taken from a buffer at any step of packing, each exactly once.

Evidence stands in chunks of its own where heavy topics exist.
A throttled topic keeps the wanted rate, and every message that is left out is counted.
A filter accepts exactly what its patterns say, and always the topics that document the drive.
Compressions are listed once: all that are written can be read, and unknown ones are errors.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from robotctl.base.errors import ConfigError
from robotctl.config import Config, with_setting
from robotctl.recording import Compression, Recorder, Topic, read_messages
from robotctl.recording.format.records import MESSAGE_HEAD, PlainMessage
from robotctl.recording.read.chunks import unpack
from robotctl.recording.read.read_limits import Damaged
from robotctl.recording.read.records import walk_records
from robotctl.recording.write.bag_writer import BagWriter
from robotctl.recording.write.buffer import OutOfMemory, PackBuffer, PackedMessages, pack
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.recorder import MessageGate
from robotctl.recording.write.recorder_options import RateByTopic, TopicFilter
from robotctl.recording.write.writer_thread import EvidenceChunks
from robotctl.testing.drives import GID, ODOMETRY, START_NS, TWIST
from tests.support.cases import for_each
from tests.support.recordings import Tape, number_of, numbered, read_strictly, summary_of


def packing(buffer: PackBuffer, number: int, channel: int, log_ns: int) -> Iterator[None]:
    """Pack a message as the recorder does; yield at each point where the threads may switch."""
    record = MESSAGE_HEAD.pack(5, 22 + 52, channel, number, log_ns, 0) + numbered(number)
    start = buffer.end
    buffer.unordered.add(channel)
    yield
    buffer.data[start : start + len(record)] = record
    yield
    buffer.indexes[channel].append(log_ns)
    yield
    buffer.indexes[channel].append(start)
    yield
    buffer.end = start + len(record)


def numbers_in(packed: PackedMessages) -> list[int]:
    """Return the messages that the indexes point to, and check that no other is there."""
    data = b"".join(bytes(part) for part in packed.parts)
    entries = []
    times = []
    for channel, index in packed.indexes.items():
        for log_ns, offset in zip(index[::2], index[1::2], strict=True):
            head = MESSAGE_HEAD.unpack_from(data, offset)
            assert (head[0], head[2], head[4]) == (5, channel, log_ns)
            entries.append((offset, number_of(data[offset + MESSAGE_HEAD.size :])))
            times.append(log_ns)
    assert [offset for offset, _ in sorted(entries)] == list(range(0, len(data), 83))
    assert (packed.start_ns, packed.end_ns) == (min(times), max(times))
    return [number for _, number in sorted(entries)]


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(0, 2**64 - 1), st.sets(st.integers(0, 4))),
        max_size=40,
    )
)
@example([(0, 1, set()), (0, 2, {3}), (1, 3, {2}), (0, 4, {1, 2, 3, 4})])
def test_what_is_taken_at_any_step_is_each_message_once_and_in_order(
    messages: list[tuple[int, int, set[int]]],
) -> None:
    buffer = PackBuffer(40 * 83)
    buffer.make_indexes(3)
    found: list[int] = []

    def take() -> None:
        packed = buffer.take()
        if packed is not None:
            found.extend(numbers_in(packed))

    for number, (channel, log_ns, takes_at) in enumerate(messages):
        for step, _ in enumerate(packing(buffer, number, channel, log_ns)):
            if step in takes_at:
                take()
        if 4 in takes_at:
            take()
    take()
    assert found == list(range(len(messages)))
    assert buffer.take() is None


CAMERA = Topic("/camera", "sensor_msgs/msg/CompressedImage")
EVIDENCE = frozenset({TWIST.name, ODOMETRY.name})
IMAGE = 40_000


def channels() -> list[ChannelState]:
    return [ChannelState(topic) for topic in (TWIST, CAMERA, ODOMETRY)]


def joined(messages: list[PlainMessage]) -> PackedMessages:
    """Pack messages into one part, as a PackBuffer does."""
    packed = pack(messages)
    return replace(packed, parts=[b"".join(bytes(part) for part in packed.parts)])


def messages_of(packed: PackedMessages) -> list[PlainMessage]:
    """Return the messages that the indexes of a chunk lead to, in the order of their records."""
    data = b"".join(bytes(part) for part in packed.parts)
    found = []
    for channel, index in packed.indexes.items():
        for log_ns, offset in zip(index[::2], index[1::2], strict=True):
            _, length, number, sequence, time_ns, publish_ns = MESSAGE_HEAD.unpack_from(
                data, offset
            )
            assert (number, time_ns) == (channel, log_ns)
            content = data[offset + MESSAGE_HEAD.size : offset + 9 + length]
            found.append((offset, (channel, content, log_ns, publish_ns, sequence)))
    found.sort()
    starts = [start - 9 for opcode, start, _ in walk_records(data) if opcode == Opcode.MESSAGE]
    assert [offset for offset, _ in found] == starts
    return [message for _, message in found]


def mixed(seed: int, count: int) -> list[PlainMessage]:
    """Return messages of all channels, in a random order, with times that step back."""
    dice = random.Random(seed)
    made: list[PlainMessage] = []
    for number in range(count):
        channel = dice.choice((0, 0, 1, 2))
        size = IMAGE if channel == 1 else dice.choice((52, 724))
        log_ns = START_NS + number * 1000 - dice.choice((0, 0, 5000))
        made.append((channel, dice.randbytes(size), log_ns, log_ns - 1, number))
    return made


@for_each("chosen", [(0,), (1,), (0, 2)])
def test_what_needs_no_separation_stays_as_it_is(chosen: tuple[int, ...]) -> None:
    packed = joined([each for each in mixed(1, 40) if each[0] in chosen])
    assert EvidenceChunks(EVIDENCE, channels()).separate(packed) == (packed,)


def test_a_little_of_other_topics_stays_with_the_evidence() -> None:
    packed = joined([(channel, b"x" * 1000, START_NS, START_NS, 0) for channel in (0, 1, 1, 1)])
    assert EvidenceChunks(EVIDENCE, channels()).separate(packed) == (packed,)


def record(folder: Path, compression: Compression, images: int) -> Recorder:
    recorder = Tape(folder, evidence=EVIDENCE, compression=compression, flush_s=3600.0)
    twist, camera, odometry = map(recorder.add_topic, (TWIST, CAMERA, ODOMETRY))
    dice = random.Random(7)
    for number in range(images * 10):
        time_ns = START_NS + number * 1_000_000
        channel = (camera, twist, odometry)[min(number % 10, 2)]
        data = dice.randbytes(IMAGE) if channel == camera else numbered(number)
        recorder.write(channel, data, time_ns, time_ns, number, GID)
    return recorder


@pytest.mark.parametrize("compression", list(Compression))
def test_readers_get_the_messages_in_the_order_of_time_from_chunks_of_evidence_or_images(
    tmp_path: Path, compression: Compression
) -> None:
    """Without an index, in the order of time of each topic: docs/recordings.md says so."""
    stats = record(tmp_path / "run", compression, 100).close()
    assert (stats.written, stats.dropped) == (1000, 0)
    times = [message.log_ns for message in read_messages(tmp_path / "run")]
    assert times == [START_NS + number * 1_000_000 for number in range(1000)]
    streamed: dict[int, list[int]] = {0: [], 1: [], 2: []}
    with stats.file.open("rb") as stream:
        for each in StreamReader(stream, validate_crcs=True).records:
            if isinstance(each, Message):
                streamed[each.channel_id].append(each.log_time)
        assert all(each == sorted(each) for each in streamed.values())
        assert len(streamed[0] + streamed[2]) == 900
        stream.seek(0)
        found = make_reader(stream).iter_messages()
        assert [message.log_time for *_, message in found] == times
    held = [set(chunk.message_index_offsets) for chunk in summary_of(stats.file).chunk_indexes]
    assert {1} in held
    assert all(1 not in each or each == {1} for each in held[:-1])


def test_evidence_that_is_written_is_not_dropped_with_images_that_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = BagWriter.write

    def without_memory(self: BagWriter, packed: PackedMessages) -> None:
        if 1 in packed.indexes:
            raise OutOfMemory("no memory for images")
        write(self, packed)

    monkeypatch.setattr(BagWriter, "write", without_memory)
    stats = record(tmp_path / "run", Compression.ZSTD, 100).close()
    assert (stats.received, stats.written, stats.dropped, stats.queued) == (1000, 900, 100, 0)
    assert sum(1 for _ in read_messages(tmp_path / "run")) == 900


GATED = Topic("/camera/image", "sensor_msgs/msg/Image")
FIRST_NS = 1_800_000_000_000_000_000
CAMERA_GID = b"camera".ljust(16)


class FakeRecorder(Recorder):
    """Remembers what is kept, and writes nothing."""

    def __init__(self) -> None:
        self.kept_ns: list[int] = []
        self.left_out = 0

    def write(self, channel: int, data: object, log_ns: int, *_: object) -> None:
        self.kept_ns.append(log_ns)

    def leave_out(self, *_: object) -> None:
        self.left_out += 1


def kept(times_ns: list[int], most_hz: float) -> FakeRecorder:
    recorder = FakeRecorder()
    gate = MessageGate(recorder, 0, most_hz)
    for number, log_ns in enumerate(times_ns):
        gate(b"", log_ns, log_ns, number + 1, CAMERA_GID)
    return recorder


@given(st.floats(0.5, 200.0), st.floats(0.5, 200.0))
def test_a_regular_topic_keeps_the_wanted_rate(hz: float, most_hz: float) -> None:
    times_ns = [FIRST_NS + round(number * 1e9 / hz) for number in range(2000)]
    found = kept(times_ns, most_hz)
    seconds = (times_ns[-1] - times_ns[0]) / 1e9
    assert len(found.kept_ns) == pytest.approx(seconds * min(hz, most_hz), rel=0.01, abs=1.5)
    assert len(found.kept_ns) + found.left_out == 2000


@given(st.lists(st.floats(0.0, 3.0), max_size=200), st.floats(0.5, 50.0))
def test_no_time_holds_more_than_its_share(gaps_s: list[float], most_hz: float) -> None:
    at_ns, times_ns = FIRST_NS, []
    for gap_s in gaps_s:
        at_ns += round(gap_s * 1e9)
        times_ns.append(at_ns)
    kept_ns = kept(times_ns, most_hz).kept_ns
    for first, begin_ns in enumerate(kept_ns):
        for count, end_ns in enumerate(kept_ns[first:], 1):
            assert count <= (end_ns - begin_ns) / 1e9 * most_hz + 2.0 + 1e-6


def test_a_clock_that_is_set_back_ends_no_recording() -> None:
    times_ns = [FIRST_NS + k * 100_000_000 for k in range(50)]
    back_ns = [each - 3600 * 1_000_000_000 for each in times_ns]
    assert len(kept(times_ns + back_ns, 5.0).kept_ns) == 50


def test_a_shut_gate_keeps_nothing_until_it_opens() -> None:
    recorder = FakeRecorder()
    gate = MessageGate(recorder, 0)
    for number, is_shut in enumerate([False, True, True, False], 1):
        gate.is_shut = is_shut
        gate(b"", FIRST_NS + number, FIRST_NS, number, CAMERA_GID)
    assert recorder.kept_ns == [FIRST_NS + 1, FIRST_NS + 4]
    assert recorder.left_out == 2


@pytest.fixture
def plain_recorder(tmp_path: Path) -> Recorder:
    return Recorder(tmp_path / "run", on_failure=pytest.fail)


def test_what_is_left_out_is_counted_and_not_lost(plain_recorder: Recorder) -> None:
    gate = MessageGate(plain_recorder, plain_recorder.add_topic(GATED), 5.0)
    for number in range(300):  # 30 Hz for 10 s
        at_ns = FIRST_NS + number * 33_333_333
        gate(b"pixels", at_ns, at_ns, number + 1, CAMERA_GID)
    channel = plain_recorder.channel(0)
    stats = plain_recorder.close()

    assert (stats.received, stats.written, stats.throttled) == (50, 50, 250)
    assert (stats.lost, stats.unseen, stats.dropped) == (0, 0, 0)
    assert (channel.arrived, channel.expected) == (300, {CAMERA_GID: 301})
    assert len(read_strictly(stats.file)) == 50
    times_ns = [each.log_ns for each in read_messages(stats.file)]
    gaps = [b - a for a, b in pairwise(times_ns)]
    assert max(gaps) <= 2 * min(gaps)


@for_each(
    ("topic", "type_name", "rate_hz"),
    [
        ("/camera/left", "sensor_msgs/msg/Image", 5.0),
        ("/camera/info", "sensor_msgs/msg/CameraInfo", 5.0),
        ("/rear", "sensor_msgs/msg/Image", 1.0),
        ("/scan", "sensor_msgs/msg/LaserScan", None),
    ],
)
def test_the_first_pattern_that_matches_counts(
    topic: str, type_name: str, rate_hz: float | None
) -> None:
    rates = RateByTopic(["/camera/*=5", "type:sensor_msgs/msg/Image=1", "/*/left=9"])
    assert rates.of(topic, type_name) == rate_hz


NAMES = st.from_regex(r"(/[a-z_][a-z0-9_]{0,3}){1,3}", fullmatch=True)
TYPES = st.sampled_from(["std_msgs/msg/String", "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"])
PATTERNS = st.one_of(
    NAMES,
    NAMES.map(lambda name: f"{name}/*"),
    st.sampled_from(["*", "/?", "/[a-f]*", "type:sensor_msgs/*", "type:std_msgs/msg/String"]),
)
LISTS = st.lists(PATTERNS, max_size=4)


@for_each(
    ("pattern", "topic", "matches"),
    [
        ("/scan", "/scan", True),
        ("/scan", "/scan2", False),
        ("/scan", "/robot/scan", False),
        ("/scan", "/Scan", False),
        ("/camera/*", "/camera/left/image", True),
        ("/camera/*", "/camera", False),
        ("/camera/*", "/camera2/image", False),
        ("*/image", "/camera/left/image", True),
        ("/joint_?", "/joint_1", True),
        ("/joint_?", "/joint_12", False),
        ("/joint_[!12]", "/joint_3", True),
        ("/joint_[!12]", "/joint_2", False),
        ("type:sensor_msgs/msg/Image", "/anything", True),
        ("type:sensor_msgs/msg/Imag", "/anything", False),
        ("type:sensor_msgs/*", "/anything", True),
        ("/sensor_msgs/msg/Image", "/anything", False),
    ],
)
def test_a_pattern_matches_what_the_page_says(pattern: str, topic: str, matches: bool) -> None:
    type_name = "sensor_msgs/msg/Image"
    assert TopicFilter(include=[pattern]).records(topic, type_name) is matches
    assert TopicFilter(exclude=[pattern]).records(topic, type_name) is not matches


@given(NAMES, TYPES)
def test_without_patterns_everything_is_recorded(topic: str, type_name: str) -> None:
    assert TopicFilter().records(topic, type_name)


@given(LISTS, LISTS, NAMES, TYPES)
def test_an_exclusion_counts_more_than_an_inclusion(
    include: list[str], exclude: list[str], topic: str, type_name: str
) -> None:
    recorded = TopicFilter(include, exclude).records(topic, type_name)
    excluded = not TopicFilter(exclude=exclude).records(topic, type_name)
    included = TopicFilter(include=include).records(topic, type_name)
    assert recorded == (included and not excluded)


@given(LISTS, LISTS, NAMES, TYPES)
def test_a_list_matches_what_any_of_its_patterns_matches_in_any_order(
    first: list[str], second: list[str], topic: str, type_name: str
) -> None:
    def excluded(patterns: list[str]) -> bool:
        return not TopicFilter(exclude=patterns).records(topic, type_name)

    assert excluded(first + second) == (excluded(first) or excluded(second))
    assert excluded(first + second) == excluded(second + first)


@given(LISTS, LISTS, NAMES, TYPES)
def test_what_proves_the_drive_is_recorded_whatever_the_patterns_say(
    include: list[str], exclude: list[str], topic: str, type_name: str
) -> None:
    chosen = TopicFilter(include, [*exclude, "*"], always=[topic])
    assert chosen.records(topic, type_name)
    assert not chosen.can_leave_out(topic)
    assert not chosen.records(f"{topic}x", type_name)
    assert chosen.can_leave_out(f"{topic}x")


def test_an_unknown_compression_is_refused_and_never_taken_for_none() -> None:
    with pytest.raises(ConfigError, match=r"recording\.compression: 'lz5'.*use zstd, lz4, none"):
        with_setting(Config(), "recording.compression", "lz5")
    with pytest.raises(Damaged, match="compressed by 'lz5', which is not supported"):
        unpack("lz5", b"", 0)
