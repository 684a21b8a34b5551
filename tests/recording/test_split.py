"""A recording continues in another file without a gap, and each file stands alone."""

from __future__ import annotations

import os
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader as RosbagsReader

from robotctl.base.errors import Refused
from robotctl.recording import (
    Compression,
    Recorder,
    RecorderOptions,
    RecorderState,
    Topic,
    read_info,
    read_messages,
)
from robotctl.recording.format.disk import DiskFile
from robotctl.recording.format.topics import read_ledger
from robotctl.recording.write import bag_writer
from robotctl.testing.drives import GID, ODOMETRY, QOS, START_NS, TWIST
from robotctl.testing.faults import FailingFile, GatedFile
from tests.support.recordings import (
    Stored,
    Tape,
    bag_of,
    metadata_of,
    number_of,
    read_strictly,
    summary_of,
    write_numbered,
)
from tests.support.waiting import until, until_longer

LATCHED = Topic(
    "/robot_status",
    "robot_controller/msg/RobotStatus",
    "uint8 mode\n",
    "RIHS01_ef",
    QOS.replace("volatile", "transient_local"),
)


def files_of(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.mcap"), key=lambda path: int(path.stem.rpartition("_")[2]))


def test_fifty_splits_by_size_lose_nothing(tmp_path: Path) -> None:
    recorder = Tape(
        tmp_path / "run",
        compression=Compression.NONE,
        chunk_bytes=2048,
        split_bytes=20_000,
        flush_s=0.002,
    )
    number = 0
    while len(recorder.begun) < 50:
        recorder.commands(range(number + 1, number + 501))
        number += 500
        recorder.settle()
        assert number < 50_000
    stats = recorder.close()
    files = files_of(tmp_path / "run")
    assert [path.name for path in files] == [f"run_{n}.mcap" for n in range(len(files))]
    assert recorder.begun == files[1:]
    found = [m.sequence for path in files for m in read_strictly(path)]
    assert found == list(range(1, number + 1))
    assert (stats.written, stats.dropped, stats.queued) == (number, 0, 0)
    assert stats.bytes == sum(path.stat().st_size for path in files)
    assert stats.file == files[-1]


def test_a_bag_of_many_files_opens_as_one(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", chunk_bytes=2048, split_bytes=10_000)
    twist, odometry = recorder.add_topic(TWIST), recorder.add_topic(ODOMETRY)
    for number in range(1, 2001):
        write_numbered(recorder, [twist, odometry][number % 2], range(number, number + 1))
    recorder.close()
    assert len(files_of(tmp_path / "run")) > 3
    with RosbagsReader(tmp_path / "run") as bag:
        assert bag.message_count == 2000
        assert sum(1 for _ in bag.messages()) == 2000
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing) == (2000, ())
    assert [number_of(m.data) for m in read_messages(tmp_path / "run")] == list(range(1, 2001))
    files = bag_of(tmp_path / "run")["files"]
    assert sum(file["message_count"] for file in files) == 2000


def test_a_file_is_split_by_its_age(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", flush_s=0.01, split_s=0.05)
    number = 0
    while len(recorder.begun) < 2:
        number += 1
        recorder.commands(range(number, number + 1))
        time.sleep(0.001)
        assert number < 20_000
    recorder.close()
    found = [m.sequence for path in files_of(tmp_path / "run") for m in read_strictly(path)]
    assert found == list(range(1, number + 1))


def test_what_comes_after_a_split_is_in_the_new_file_however_slow_the_disk(tmp_path: Path) -> None:
    gate = threading.Event()
    gate.set()
    recorder = Tape(tmp_path / "run", open_file=lambda path: GatedFile(path, gate.wait))
    gate.clear()
    for file in range(20):
        recorder.commands(range(file * 10 + 1, file * 10 + 11))
        recorder.split()
    gate.set()
    recorder.close()
    found = [[m.sequence for m in read_strictly(path)] for path in files_of(tmp_path / "run")]
    assert found == [*(list(range(n * 10 + 1, n * 10 + 11)) for n in range(20)), []]


def test_a_full_file_is_told_once_and_goes_on_until_it_is_split(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", chunk_bytes=1024, split_bytes=5000, tells_full=True)
    for file in range(3):
        recorder.commands(range(file * 1000 + 1, file * 1000 + 1001))
        recorder.settle()
        assert len(recorder.full) == file + 1
        recorder.split()
        until_longer(recorder.begun, file)
    recorder.close()
    assert recorder.full == files_of(tmp_path / "run")[:3]
    found = [[m.sequence for m in read_strictly(path)] for path in files_of(tmp_path / "run")]
    assert found == [*(list(range(n * 1000 + 1, n * 1000 + 1001)) for n in range(3)), []]


def test_what_is_latched_is_repeated_at_the_split_though_the_clock_was_set_back(
    tmp_path: Path,
) -> None:
    hour_ns = 3600 * 10**9
    recorder = Tape(tmp_path / "run")
    twist, latched = recorder.add_topic(TWIST), recorder.add_topic(LATCHED)
    recorder.write(latched, b"map", START_NS + hour_ns, START_NS + hour_ns, 1, b"a")
    recorder.settle()
    write_numbered(recorder, twist, range(1, 11))
    recorder.split()
    write_numbered(recorder, twist, range(11, 21))
    recorder.split()
    recorder.close()
    ends = [START_NS + number * 1_000_000 for number in (10, 20)]
    for path, end_ns in zip(files_of(tmp_path / "run")[1:], ends, strict=True):
        assert [m.log_ns for m in read_strictly(path) if m.data == b"map"] == [end_ns]


def test_what_is_latched_and_was_dropped_is_repeated_at_its_own_time(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", chunk_bytes=1024, memory_bytes=4600)
    recorder.write(recorder.add_topic(LATCHED), bytes(1500), START_NS, START_NS, 1, b"a")
    recorder.split()
    stats = recorder.close()
    assert (stats.dropped, stats.written) == (1, 0)
    assert [m.log_ns for m in read_strictly(stats.file)] == [START_NS]


def test_an_index_that_grows_too_large_ends_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag_writer, "MAX_INDEX_BYTES", 2000)
    recorder = Tape(tmp_path / "run", chunk_bytes=4096)
    channels = [recorder.add_topic(replace(TWIST, name=f"/topic{n}")) for n in range(20)]
    for number in range(1, 201):
        for channel in channels:
            write_numbered(recorder, channel, range(number, number + 1))
        until(lambda: recorder.stats().queued < 1000)
    stats = recorder.close()
    files = files_of(tmp_path / "run")
    assert len(files) > 2
    assert sum(len(read_strictly(path)) for path in files) == stats.written == 4000


def test_a_name_that_is_taken_is_passed_over(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run")
    recorder.commands(range(1, 11))
    (tmp_path / "run" / "run_1.mcap").mkdir()
    (tmp_path / "run" / "run_2.mcap").symlink_to(tmp_path / "elsewhere")
    recorder.split()
    recorder.commands(range(11, 21))
    stats = recorder.close()
    assert stats.file.name == "run_3.mcap"
    assert [m.sequence for m in read_strictly(stats.file)] == list(range(11, 21))
    assert not (tmp_path / "elsewhere").exists()


def test_each_file_stands_alone(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run", metadata=lambda: {"robot": "robot"})
    twist, latched = recorder.add_topic(TWIST), recorder.add_topic(LATCHED)
    recorder.write(latched, b"old", START_NS, START_NS - 9, 1, b"a")
    recorder.write(latched, b"map", START_NS + 1, START_NS - 8, 2**32 + 7, b"a")
    recorder.write(latched, b"tf", START_NS + 2, -5, 3, b"b")
    write_numbered(recorder, twist, range(1, 11))
    recorder.split()
    until(lambda: bool(recorder.begun))
    write_numbered(recorder, twist, range(11, 16))
    stats = recorder.close()
    second = files_of(tmp_path / "run")[1]
    messages = read_strictly(second)
    repeated = [m for m in messages if m.topic == "/robot_status"]
    end_of_first = START_NS + 10 * 1_000_000
    assert repeated == [
        Stored("/robot_status", b"map", end_of_first, START_NS - 8, 7),
        Stored("/robot_status", b"tf", end_of_first, 0, 3),
    ]
    assert messages[:2] == repeated
    names = [name for name, _ in metadata_of(second)]
    assert names == ["robotctl", "rosbag2", "rosbag2", "robotctl.ledger"]
    topics = {channel.topic for channel in summary_of(second).channels.values()}
    assert topics == {"/cmd_vel", "/robot_status"}
    assert (stats.received, stats.written) == (18, 18)  # what is repeated is not received
    with RosbagsReader(tmp_path / "run") as bag:
        assert bag.message_count == 20


def test_large_latched_messages_never_cause_a_split(tmp_path: Path) -> None:
    recorder = Tape(
        tmp_path / "run",
        compression=Compression.NONE,
        chunk_bytes=16_384,
        split_bytes=100_000,
        flush_s=0.002,
    )
    twist, latched = recorder.add_topic(TWIST), recorder.add_topic(LATCHED)
    for number in range(9):
        recorder.write(latched, bytes(12_000), START_NS, START_NS, number, b"%d" % number)
    recorder.write(latched, b"small", START_NS, START_NS, 1, b"small")
    recorder.settle()
    before = len(recorder.begun)
    recorder.split()
    until(lambda: len(recorder.begun) > before)
    for number in range(1, 101):
        write_numbered(recorder, twist, range(number, number + 1))
        recorder.settle()
    stats = recorder.close()
    assert len(recorder.begun) == before + 1
    last = files_of(tmp_path / "run")[-1]
    repeated = [len(m.data) for m in read_strictly(last) if m.topic == "/robot_status"]
    assert repeated == [12_000, 12_000, 5]
    (ledger,) = (t for t in stats.topics if t.name == "/robot_status")
    assert 7 <= ledger.not_repeated <= 7 * len(recorder.begun)
    told = read_ledger(read_info(last).metadata)["/robot_status"]
    assert told["not_repeated"] == ledger.not_repeated


def test_a_split_that_finds_the_disk_full_keeps_what_was_written(tmp_path: Path) -> None:
    opened: list[Path] = []

    def open_file(path: Path) -> DiskFile:
        opened.append(path)
        return FailingFile(path, 1) if len(opened) == 3 else DiskFile(path)

    recorder = Tape(
        tmp_path / "run", chunk_bytes=1024, split_bytes=5000, open_file=open_file, may_fail=True
    )
    recorder.commands(range(1, 2001))
    until(lambda: bool(recorder.failures))
    stats = recorder.close()
    assert stats.state is RecorderState.FAILED
    assert stats.received == stats.written + stats.dropped == 2000
    first, second = files_of(tmp_path / "run")
    found = [m.sequence for path in (first, second) for m in read_strictly(path)]
    assert found == list(range(1, stats.written + 1))
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing) == (stats.written, ())


def test_a_disk_that_gets_full_is_told_before_and_stops_the_recording_in_time(
    tmp_path: Path,
) -> None:
    free = [10_000_000_000]
    recorder = Tape(
        tmp_path / "run",
        flush_s=0.005,
        sync_s=0.005,
        free_space=lambda folder: free[0],
        may_fail=True,
    )
    recorder.commands(range(1, 11))
    assert recorder.stats().warning == ""
    free[0] = 1_000_000_000
    until(lambda: recorder.stats().warning != "")
    assert recorder.stats().warning == "1000 MB left on the disk; recording stops at 500 MB"
    assert recorder.stats().state is RecorderState.RECORDING
    free[0] = 400_000_000
    until(lambda: bool(recorder.failures))
    assert "only 400 MB left on the disk, 500 MB stay free" in recorder.failures[0]
    stats = recorder.close()
    assert (len(read_strictly(stats.file)), stats.written, stats.warning) == (10, 10, "")


def test_a_start_on_an_almost_full_disk_is_refused(tmp_path: Path) -> None:
    options = RecorderOptions(free_space=lambda folder: 1000)
    with pytest.raises(Refused, match="only 0 MB left on the disk"):
        Recorder(tmp_path / "run", options, on_failure=pytest.fail)
    assert not (tmp_path / "run").exists()


def test_latched_messages_of_all_topics_share_one_budget_and_no_split_causes_another(
    tmp_path: Path,
) -> None:
    recorder = Tape(tmp_path / "run", memory_bytes=24 << 20, split_bytes=24 << 20)
    channels = [recorder.add_topic(replace(LATCHED, name=f"/map_{i}")) for i in range(9)]
    for channel in channels:
        recorder.write(channel, os.urandom(3 << 20), START_NS, START_NS, 1, GID)
        recorder.settle()
    until(lambda: bool(recorder.begun))
    assert recorder.stats().not_repeated == 7
    recorder.write(channels[0], b"small", START_NS, START_NS, 2, GID)  # frees room for another
    recorder.write(channels[8], os.urandom(3 << 20), START_NS, START_NS, 2, GID)
    stats = recorder.close()
    assert (stats.not_repeated, stats.received, stats.dropped) == (7, 11, 0)
    assert len(recorder.begun) == 1


def test_a_large_latched_message_is_not_kept_in_memory(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run")
    channel = recorder.add_topic(replace(LATCHED))
    recorder.write(channel, bytes(33 << 20), START_NS, START_NS, 1, GID)
    for publisher in range(100):
        recorder.write(channel, b"x", START_NS, START_NS, 1, publisher.to_bytes(2, "big"))
    assert len(recorder._channels[channel].latched_messages()) == 64
    recorder.write(channel, bytes(33 << 20), START_NS, START_NS, 2, b"\0\x63")
    assert len(recorder._channels[channel].latched_messages()) == 63  # the older one is out of date
    recorder.close()


def test_a_listener_of_splits_that_raises_does_not_stop_the_recording(tmp_path: Path) -> None:
    def raise_it(path: Path) -> None:
        raise RuntimeError(path)

    options = RecorderOptions(chunk_bytes=1024, split_bytes=5000)
    recorder = Recorder(tmp_path / "run", options, on_failure=pytest.fail, on_split=raise_it)
    write_numbered(recorder, recorder.add_topic(TWIST), range(1, 1001))
    stats = recorder.close()
    assert (stats.state, stats.written) == (RecorderState.CLOSED, 1000)
