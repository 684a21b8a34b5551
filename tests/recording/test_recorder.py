"""Every message given to the recorder is in the file, or counted.

The names that a library user may import from `robotctl.recording`.
"""

from __future__ import annotations

import json
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader as RosbagsReader

import robotctl.recording
from robotctl.base.errors import Refused
from robotctl.recording import (
    Compression,
    Recorder,
    RecorderState,
    RecorderStats,
    Topic,
)
from robotctl.recording.write import bag_writer
from robotctl.recording.write import recorder as recorder_module
from robotctl.recording.write.writer_thread import NICE, SLICE_NS
from robotctl.testing.drives import GID, ODOMETRY, QOS, START_NS, TWIST
from tests.support.lines import run_python
from tests.support.recordings import (
    Stored,
    Tape,
    bag_of,
    metadata_of,
    numbered,
    read_strictly,
    summary_of,
    write_numbered,
)
from tests.support.waiting import until

OpenRecorder = Callable[..., Tape]
MIB = 1 << 20


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "recordings" / "robot_20260101_120000"


@pytest.fixture
def open_recorder(folder: Path) -> Iterator[OpenRecorder]:
    """Open recorders that are closed at the end; a failure of one fails the test."""
    recorders: list[Tape] = []

    def open_it(**options: Any) -> Tape:
        recorders.append(Tape(folder, **options))
        return recorders[-1]

    yield open_it
    for recorder in recorders:
        recorder.close()


def assert_accounted(stats: RecorderStats) -> None:
    for topic in stats.topics:
        assert topic.received == topic.written + topic.queued + topic.dropped
        assert min(topic.received, topic.written, topic.queued, topic.dropped) >= 0
    assert stats.received == stats.written + stats.queued + stats.dropped


@settings(max_examples=60)
@given(
    messages=st.lists(
        st.tuples(
            st.integers(0, 3),
            st.binary(max_size=3000),
            st.integers(-(2**63), 2**65),
            st.integers(-(2**63), 2**65),
            st.integers(0, 2**40),
        ),
        max_size=60,
    ),
    compression=st.sampled_from(Compression),
    chunk_bytes=st.integers(64, 4096),
)
def test_any_message_is_kept_with_its_numbers_clamped_to_their_fields(
    tmp_path_factory: pytest.TempPathFactory,
    messages: list[tuple[int, bytes, int, int, int]],
    compression: Compression,
    chunk_bytes: int,
) -> None:
    folder = tmp_path_factory.mktemp("property") / "run"
    recorder = Tape(folder, compression=compression, chunk_bytes=chunk_bytes)
    for number in range(4):
        recorder.add_topic(Topic(f"/topic{number}", "std_msgs/msg/String"))
    expected = []
    for channel, data, log_ns, publish_ns, sequence in messages:
        recorder.write(channel, data, log_ns, publish_ns, sequence, GID)
        log, publish = (min(max(each, 0), 2**64 - 1) for each in (log_ns, publish_ns))
        expected.append(Stored(f"/topic{channel}", data, log, publish, sequence % 2**32))
    stats = recorder.close()
    assert read_strictly(stats.file) == expected
    assert stats.received == stats.written == len(messages)
    counted = summary_of(stats.file).statistics
    assert counted is not None
    times = [message.log_ns for message in expected] or [0]
    found = counted.message_start_time, counted.message_end_time
    assert found == (min(times), max(times))


def test_a_topic_without_messages_is_in_the_growing_file(open_recorder: OpenRecorder) -> None:
    recorder = open_recorder(flush_s=0.01)
    file = recorder.stats().file

    def topics() -> set[str]:
        return {channel.topic for channel in summary_of(file).channels.values()}

    assert topics() == set()
    recorder.add_topic(TWIST)
    until(lambda: topics() == {"/cmd_vel"})


def test_more_topics_than_the_format_numbers_are_refused(
    open_recorder: OpenRecorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder_module, "MAX_TOPICS", 1)
    recorder = open_recorder()
    recorder.add_topic(TWIST)
    with pytest.raises(Refused, match="at most 1 topics"):
        recorder.add_topic(ODOMETRY)


def test_the_folder_is_a_bag_of_version_9_that_rosbags_opens_from_its_first_moment(
    open_recorder: OpenRecorder, folder: Path
) -> None:
    recorder = open_recorder()
    begun = bag_of(folder)
    assert begun["version"] == 9
    assert begun["relative_file_paths"] == [f"{folder.name}_0.mcap"]
    never = begun["starting_time"]["nanoseconds_since_epoch"]
    assert never == 2**63 - 1  # as rosbag2 writes it without messages
    with RosbagsReader(folder) as bag:
        assert bag.message_count == 0
    recorder.commands(range(1, 101))
    write_numbered(recorder, recorder.add_topic(ODOMETRY), range(1, 51))
    recorder.close()
    ended = bag_of(folder)
    assert ended["message_count"] == 150
    assert ended["duration"]["nanoseconds"] == 99_000_000
    topic = ended["topics_with_message_count"][0]["topic_metadata"]
    assert topic["offered_qos_profiles"] == yaml.safe_load(QOS)
    with RosbagsReader(folder) as bag:
        assert {c.topic: (c.msgtype, c.msgcount, c.digest) for c in bag.connections} == {
            "/cmd_vel": ("geometry_msgs/msg/Twist", 100, TWIST.type_hash),
            "/odom": ("nav_msgs/msg/Odometry", 50, ODOMETRY.type_hash),
        }
        assert bag.connections[0].ext.offered_qos_profiles[0].depth == 10  # type: ignore[union-attr]
        assert [data for _, _, data in bag.messages(bag.connections[:1])] == [
            numbered(number) for number in range(1, 101)
        ]


def test_the_folder_is_a_bag_that_plays_while_it_grows(
    open_recorder: OpenRecorder, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """rosbags reads only the topics that `metadata.yaml` lists: each is listed at once."""

    def listed() -> dict[str, int]:
        topics = bag_of(folder)["topics_with_message_count"]
        return {topic["topic_metadata"]["name"]: topic["message_count"] for topic in topics}

    monkeypatch.setattr(bag_writer, "METADATA_PERIOD_S", 3600.0)
    recorder = open_recorder(flush_s=0.01, sync_s=0.01)
    recorder.commands(range(1, 11))
    until(lambda: recorder.stats().written == 10)
    until(lambda: "/cmd_vel" in listed())
    with RosbagsReader(folder) as bag:
        assert len(list(bag.messages())) == 10
    monkeypatch.setattr(bag_writer, "METADATA_PERIOD_S", 0.01)
    write_numbered(recorder, recorder.add_topic(ODOMETRY), range(1, 11))
    until(lambda: "/odom" in listed())
    recorder.commands(range(11, 21))
    until(lambda: listed() == {"/cmd_vel": 20, "/odom": 10})


def test_the_file_describes_itself(folder: Path) -> None:
    recorder = Tape(folder, metadata=lambda: {"robot": "robot", "mode": "IDLE"})
    recorder.commands(range(5, 15))
    recorder.commands(range(18, 20))
    stats = recorder.close()
    with stats.file.open("rb") as stream:
        assert make_reader(stream).get_header().profile == "ros2"
    names, (named, *bags, ledger) = zip(*metadata_of(stats.file), strict=True)
    assert names == ("robotctl", "rosbag2", "rosbag2", "robotctl.ledger")
    assert named == {"robot": "robot", "mode": "IDLE"}
    at_start, at_close = (yaml.safe_load(each["serialized_metadata"]) for each in bags)
    assert (at_start["message_count"], at_close["message_count"]) == (0, 12)
    assert json.loads(ledger["/cmd_vel"]) == {
        "received": 12,
        "written": 12,
        "queued": 0,
        "dropped": 0,
        "lost": 3,
        "unseen": 4,
        "bytes": 12 * 52,
        "not_repeated": 0,
        "throttled": 0,
    }
    summary = summary_of(stats.file)
    (channel_record,) = summary.channels.values()
    told = {"topic_type_hash": TWIST.type_hash, "offered_qos_profiles": QOS}
    assert channel_record.metadata == told
    assert channel_record.message_encoding == "cdr"
    (schema,) = summary.schemas.values()
    assert (schema.name, schema.encoding) == ("geometry_msgs/msg/Twist", "ros2msg")


def test_strange_names_and_malformed_qos_do_not_spoil_the_bag(
    open_recorder: OpenRecorder, folder: Path
) -> None:
    recorder = open_recorder()
    names = ['/quo"te', "/new\nline", "/\x1b[31mred", "/back\\slash", "/übung", "/: - {}", "/🤖"]
    for name, qos in zip_longest(names, ["{", "nonsense", "- 7", "[]"], fillvalue=""):
        recorder.add_topic(Topic(name, "std_msgs/msg/String", offered_qos=qos))
    summary = summary_of(recorder.close().file)
    assert {(each.name, each.encoding, each.data) for each in summary.schemas.values()} == {
        ("std_msgs/msg/String", "", b"")  # a type without definition
    }
    topics = [each["topic_metadata"] for each in bag_of(folder)["topics_with_message_count"]]
    assert [topic["name"] for topic in topics] == names
    assert [topic["offered_qos_profiles"] for topic in topics] == [[]] * len(names)


def test_a_message_larger_than_the_queue_is_dropped_and_counted(
    open_recorder: OpenRecorder,
) -> None:
    recorder = open_recorder(memory_bytes=8 * MIB)
    recorder.commands(range(1, 2))
    recorder.commands(range(2, 3), size=200 * MIB)
    recorder.commands(range(3, 4))
    stats = recorder.close()
    assert [message.sequence for message in read_strictly(stats.file)] == [1, 3]
    assert (stats.received, stats.written, stats.dropped, stats.lost) == (3, 2, 1, 0)


def slice_of(thread: int) -> int | None:
    """Return the time slice of a thread [ns], None if the kernel does not report it."""
    account = Path(f"/proc/self/task/{thread}/sched")
    text = account.read_text() if account.exists() else ""
    found = re.search(r"^se\.slice *: *(\d+)$", text, re.MULTILINE)
    return int(found[1]) if found else None


def test_the_writer_thread_ranks_below_the_loop(open_recorder: OpenRecorder) -> None:
    ours = os.getpriority(os.PRIO_PROCESS, 0)
    recorder = open_recorder()
    writer = recorder._thread._thread.native_id
    assert writer is not None
    until(lambda: os.sched_getscheduler(writer) == os.SCHED_BATCH)
    assert os.getpriority(os.PRIO_PROCESS, writer) == min(ours + NICE, 19)
    release = tuple(map(int, os.uname().release.split(".")[:2]))
    until(lambda: release < (6, 12) or slice_of(writer) in (None, SLICE_NS))
    assert os.getpriority(os.PRIO_PROCESS, 0) == ours
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    recorder.close()


def test_after_close_nothing_is_written_and_all_is_counted(open_recorder: OpenRecorder) -> None:
    recorder = open_recorder()
    recorder.commands(range(1, 11))
    first = recorder.close()
    recorder.commands(range(11, 14))
    second = recorder.close()
    assert first.state is RecorderState.CLOSED
    assert (second.received, second.written, second.queued, second.dropped) == (13, 10, 0, 3)
    assert len(read_strictly(second.file)) == 10


def test_closing_while_the_loop_still_writes_loses_no_message_uncounted(
    open_recorder: OpenRecorder,
) -> None:
    recorder = open_recorder(chunk_bytes=2048, flush_s=0.0005)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # the threads meet between any two bytecodes
    try:
        closer = threading.Timer(0.1, recorder.close)
        closer.start()
        number = 0
        while closer.is_alive():
            number += 1
            recorder.commands(range(number, number + 1))
            if number % 1000 == 0:
                assert_accounted(recorder.stats())
    finally:
        sys.setswitchinterval(interval)
    stats = recorder.close()
    assert stats.received == number
    assert stats.queued == 0
    assert_accounted(stats)
    messages = read_strictly(stats.file)
    assert len(messages) == stats.written > 100
    assert [(m.sequence, m.data) for m in messages] == [
        (number, numbered(number)) for number in range(1, len(messages) + 1)
    ]


@pytest.mark.parametrize("obstacle", ["a file in its place", "the same folder", "no permission"])
def test_a_folder_that_cannot_be_written_is_refused_in_one_sentence(
    folder: Path, obstacle: str
) -> None:
    if obstacle == "a file in its place":
        folder.parent.write_text("not a folder")
    elif obstacle == "the same folder":
        folder.mkdir(parents=True)
    else:
        folder = Path("/proc/recordings/run")
    with pytest.raises(Refused, match=r"^cannot record into .*: .*, or choose") as caught:
        Recorder(folder, on_failure=pytest.fail)
    assert "\n" not in str(caught.value)


class Slow:
    """A number that takes long to pack."""

    def __init__(self) -> None:
        self.reached = threading.Event()
        self.go_on = threading.Event()

    def __index__(self) -> int:
        self.reached.set()
        assert self.go_on.wait(20)
        return START_NS


def test_a_message_that_is_being_packed_while_closing_is_counted(
    open_recorder: OpenRecorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("robotctl.recording.write.writer_thread._SETTLE_S", 60.0)
    recorder = open_recorder(flush_s=60.0)
    channel = recorder.add_topic(TWIST)
    write_numbered(recorder, channel, range(1, 3))
    slow = Slow()
    writing = threading.Thread(
        target=recorder.write, args=(channel, numbered(3), START_NS, slow, 3, GID)
    )
    closing = threading.Thread(target=recorder.close)
    writing.start()
    assert slow.reached.wait(20)
    closing.start()
    until(lambda: recorder.stats().state is RecorderState.CLOSED)
    closing.join(0.1)
    assert closing.is_alive()  # it waits for the message
    slow.go_on.set()
    writing.join()
    closing.join()
    stats = recorder.close()
    assert (stats.received, stats.written, stats.queued, stats.dropped) == (3, 3, 0, 0)
    assert len(read_strictly(stats.file)) == 3


def test_every_public_name_can_be_imported() -> None:
    for name in robotctl.recording.__all__:
        found = getattr(robotctl.recording, name)
        assert found.__module__.startswith("robotctl.recording."), name


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Recoder'"):
        robotctl.recording.Recoder  # noqa: B018


def test_importing_the_package_imports_no_module_of_it() -> None:
    ran = run_python(
        "import sys, robotctl.recording;"
        "print([n for n in sys.modules if n.startswith(('robotctl.', 'mcap', 'zstandard'))])"
    )
    assert ran.stdout == "['robotctl.recording']\n", ran.stderr
