"""Evidence stands in chunks of its own where heavy topics exist."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from robotctl.recording import Compression, Recorder, RecorderOptions, Topic, read_messages
from robotctl.recording.format.records import MESSAGE_HEAD, PlainMessage
from robotctl.recording.read.mcap_input import walk_records
from robotctl.recording.write.bag_writer import BagWriter
from robotctl.recording.write.buffer import OutOfMemory, PackedMessages, pack
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.writer_thread import EvidenceChunks
from robotctl.testing.drives import GID, ODOMETRY, START_NS, TWIST
from tests.support.recordings import numbered

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


@pytest.mark.parametrize("seed", range(20))
def test_each_part_holds_its_messages_in_the_order_of_their_arrival(seed: int) -> None:
    messages = mixed(seed, 40)
    chunks = EvidenceChunks(EVIDENCE, channels())
    evidence, rest = chunks.separate(joined(messages))
    assert messages_of(evidence) == [each for each in messages if each[0] != 1]
    assert messages_of(rest) == [each for each in messages if each[0] == 1]
    for part in (evidence, rest):
        times = [message[2] for message in messages_of(part)]
        assert (part.start_ns, part.end_ns) == (min(times), max(times))


@pytest.mark.parametrize(
    "chosen", [(0,), (1,), (0, 2)], ids=["evidence alone", "heavy alone", "nothing heavy"]
)
def test_what_needs_no_separation_stays_as_it_is(chosen: tuple[int, ...]) -> None:
    packed = joined([each for each in mixed(1, 40) if each[0] in chosen])
    assert EvidenceChunks(EVIDENCE, channels()).separate(packed) == (packed,)


def test_a_little_of_other_topics_stays_with_the_evidence() -> None:
    packed = joined([(channel, b"x" * 1000, START_NS, START_NS, 0) for channel in (0, 1, 1, 1)])
    assert EvidenceChunks(EVIDENCE, channels()).separate(packed) == (packed,)


def test_topics_that_are_added_later_are_known() -> None:
    known = channels()[:1]
    chunks = EvidenceChunks(EVIDENCE, known)
    packed = joined(mixed(3, 40))
    chunks.separate(packed)
    known += channels()[1:]
    assert len(chunks.separate(packed)) == 2


def record(folder: Path, compression: Compression, images: int) -> Recorder:
    options = RecorderOptions(evidence=EVIDENCE, compression=compression, flush_s=3600.0)
    recorder = Recorder(folder, options, on_failure=pytest.fail)
    twist, camera, odometry = map(recorder.add_topic, (TWIST, CAMERA, ODOMETRY))
    dice = random.Random(7)
    for number in range(images * 10):
        time_ns = START_NS + number * 1_000_000
        channel = (camera, twist, odometry)[min(number % 10, 2)]
        data = dice.randbytes(IMAGE) if channel == camera else numbered(number)
        recorder.write(channel, data, time_ns, time_ns, number, GID)
    return recorder


@pytest.mark.parametrize("compression", list(Compression))
def test_readers_of_the_index_get_all_messages_in_the_order_of_time(
    tmp_path: Path, compression: Compression
) -> None:
    folder = tmp_path / "run"
    stats = record(folder, compression, 100).close()
    assert (stats.written, stats.dropped) == (1000, 0)
    times = [message.log_ns for message in read_messages(folder)]
    assert times == [START_NS + number * 1_000_000 for number in range(1000)]
    (file,) = folder.glob("*.mcap")
    with file.open("rb") as stream:
        assert [message.log_time for *_, message in make_reader(stream).iter_messages()] == times


def test_a_streaming_reader_gets_each_topic_in_the_order_of_time(tmp_path: Path) -> None:
    """Among the topics of one commit, the evidence comes first: docs/recordings.md says so."""
    record(tmp_path / "run", Compression.ZSTD, 100).close()
    (file,) = (tmp_path / "run").glob("*.mcap")
    times: dict[int, list[int]] = {}
    with file.open("rb") as stream:
        for each in StreamReader(stream, validate_crcs=True).records:
            if isinstance(each, Message):
                times.setdefault(each.channel_id, []).append(each.log_time)
    assert len(times) == 3
    assert all(each == sorted(each) for each in times.values())
    evidence = sorted(times[0] + times[2])
    assert len(evidence) == 900


def test_no_chunk_holds_evidence_and_images(tmp_path: Path) -> None:
    record(tmp_path / "run", Compression.NONE, 100).close()
    (file,) = (tmp_path / "run").glob("*.mcap")
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    held = [set(chunk.message_index_offsets) for chunk in summary.chunk_indexes]
    images = next(each.id for each in summary.channels.values() if each.topic == CAMERA.name)
    assert {images} in held
    assert all(images not in each or each == {images} for each in held[:-1])


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
