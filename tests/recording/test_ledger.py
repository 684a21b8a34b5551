"""The ledger counts exactly the messages that were sent and not received.

A recording that was shortened is reported, even if each of its files is valid.
Events are stored in the file's metadata at once, and stay there.
"""

from __future__ import annotations

import random
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Metadata

from robotctl.recording import Recording, read_info
from robotctl.recording.format.disk import Storage
from robotctl.recording.format.names import EVENT_RECORD, EventKind
from robotctl.recording.format.recorded_events import RecordedEvent, events_in
from robotctl.recording.format.topics import Topic, TopicStats, by_topic
from robotctl.recording.keep.listing import list_recording
from robotctl.recording.keep.recover import recover, recover_folder
from robotctl.recording.read.journal_reader import read_journal
from robotctl.recording.write import bag_writer
from robotctl.recording.write.channel_state import (
    MAX_LATCHED,
    MAX_PUBLISHERS,
    ChannelState,
    SequenceGaps,
)
from robotctl.testing.drives import START_NS, drive, record
from robotctl.testing.faults import FailingFile, chunks_of
from tests.support.cases import for_each
from tests.support.recordings import Tape, read_strictly, recorded, salvaged
from tests.support.waiting import until


def feed(ledger: SequenceGaps, gid: bytes, *sequences: int) -> None:
    """Feed sequence numbers as the recorder does: advance the expected one, else call `note`."""
    for sequence in sequences:
        if ledger.expected.get(gid) == sequence:
            ledger.expected[gid] = sequence + 1
        else:
            ledger.note(gid, sequence)


@pytest.mark.parametrize(
    ("heard", "lost", "unseen"),
    [
        pytest.param([(b"a", (1, 2, 5, 6, 10))], 2 + 3, 0, id="gaps"),
        pytest.param([(b"a", (101, 102))], 0, 100, id="sent before the first received"),
        pytest.param(
            [(b"a", (1, 2)), (b"b", (1, 2, 3)), (b"a", (3, 4)), (b"b", (5,))], 1, 0, id="two"
        ),
        pytest.param([(b"a", (*range(1, 500), *range(1, 300), 301))], 1, 0, id="a restart"),
        pytest.param([(b"a", (1, 2, 5, 3, 6, 4, 7))], 0, 0, id="late"),
        pytest.param([(b"a", (0, 0, 0))], 0, 0, id="a publisher that does not count"),
        pytest.param([(b"a", (1, 2, 3, 3, 4, 2, 3, 4, 5))], 0, 0, id="latched, again"),
    ],
)
def test_of_each_publisher_the_messages_in_its_gaps_are_lost(
    heard: list[tuple[bytes, tuple[int, ...]]], lost: int, unseen: int
) -> None:
    ledger = SequenceGaps()
    for gid, sequences in heard:
        feed(ledger, gid, *sequences)
    assert (ledger.lost, ledger.unseen) == (lost, unseen)
    assert any(sum(sequences) for _, sequences in heard) or ledger.expected == {}


def test_publishers_that_keep_restarting_need_bounded_memory() -> None:
    ledger = SequenceGaps()
    for number in range(3 * MAX_PUBLISHERS):
        feed(ledger, number.to_bytes(4, "big"), 1, 3)
    assert len(ledger.expected) == len(ledger._missing) == MAX_PUBLISHERS
    assert ledger.lost == 3 * MAX_PUBLISHERS


@given(st.integers(1, 300), st.floats(0, 0.9), st.randoms(use_true_random=False))
def test_lost_is_exactly_what_lies_between_the_received_ones(
    count: int, loss: float, dice: random.Random
) -> None:
    received = [number for number in range(1, count + 1) if dice.random() >= loss]
    ledger = SequenceGaps()
    feed(ledger, b"a", *received)
    if received:
        assert ledger.unseen == received[0] - 1
        assert ledger.lost == received[-1] - received[0] + 1 - len(received)


def stats(name: str, type_name: str, **counts: Any) -> TopicStats:
    return TopicStats(name=name, type_name=type_name, **counts)


def test_a_topic_that_was_recorded_anew_is_one_topic_unless_its_type_changed() -> None:
    channels = [
        stats("/b", "t", received=3, written=2, queued=1, bytes=30),
        stats("/a", "t", received=1),
        stats("/b", "t", received=4, written=4, lost=2, bytes=40),
        stats("/b", "other", received=5),
    ]
    assert by_topic(channels) == [
        stats("/b", "t", received=7, written=6, queued=1, lost=2, bytes=70),
        stats("/a", "t", received=1),
        stats("/b", "other", received=5),
    ]


def test_a_latched_message_without_memory_gives_back_the_room_of_the_one_before() -> None:
    class Endless(bytes):
        def __bytes__(self) -> bytes:
            raise MemoryError

    channel = ChannelState(Topic("/map", "a/msg/A", offered_qos="durability: transient_local"))
    assert channel.keep_latched(b"gid", bytes(100), 0, 0, 0, 1000) == 100
    assert channel.keep_latched(b"gid", Endless(10), 0, 0, 1, 900) == -100
    assert (channel.latched_messages(), channel.not_kept) == ([], 1)


@pytest.mark.parametrize("by_folder", [True, False])
def test_an_earlier_state_of_a_file_is_not_taken_for_all_of_it(
    tmp_path: Path, by_folder: bool
) -> None:
    recorder = Tape(tmp_path / "run", chunk_bytes=1024)
    recorder.commands(range(1, 201))
    recorder.settle()
    earlier = recorder.stats().file.read_bytes()
    recorder.commands(range(201, 501))
    file = recorder.close().file
    file.write_bytes(earlier)  # a whole and valid file
    path = file.parent if by_folder else file
    named = "run_0.mcap: metadata.yaml counts 500 messages, and 200 are there"
    assert read_info(path).missing == (named,)
    assert salvaged(path)[1] == [named]
    assert list_recording(path).damage == (named,)
    work = recover_folder if by_folder else recover
    assert named in "; ".join(work(path, tmp_path / "saved").lost)
    assert read_info(tmp_path / "saved").missing == ()


def test_without_metadata_yaml_the_ledger_tells_what_is_missing_but_no_removed_file(
    tmp_path: Path,
) -> None:
    recorder = Tape(tmp_path / "run", chunk_bytes=1024)
    recorder.commands(range(1, 201))
    recorder.split()
    recorder.commands(range(201, 401))
    recorder.close()
    first = tmp_path / "run" / "run_0.mcap"
    assert read_info(tmp_path / "run").missing == ()
    first.write_bytes(recorded(tmp_path / "other" / "run", 50).read_bytes())
    (tmp_path / "run" / "metadata.yaml").unlink()
    (named,) = read_info(tmp_path / "run").missing
    assert named == "its ledger counts 400 messages, and 250 are there"
    first.unlink()
    assert read_info(tmp_path / "run").missing == ()
    assert read_info(tmp_path / "run" / "run_1.mcap").missing == ()


@pytest.mark.parametrize("fail_at", [3, 5, 12])
@pytest.mark.parametrize("size", [52, 5000])
def test_a_recording_that_a_full_disk_ended_says_nothing_untrue(
    tmp_path: Path, fail_at: int, size: int
) -> None:
    def full_disk(path: Path, *_: object, **__: object) -> Storage:
        return FailingFile(path, fail_at)

    recorder = Tape(tmp_path / "run", chunk_bytes=1024, open_file=full_disk, may_fail=True)
    recorder.commands(range(1, 301), size)
    written = recorder.close().written
    assert recorder.failures
    info = read_info(tmp_path / "run")
    assert (info.message_count, info.missing) == (written, ())


def test_a_file_that_is_cut_while_it_is_read_is_named(tmp_path: Path) -> None:
    (file,) = record(tmp_path / "run", drive(2.0)).glob("*.mcap")
    chunks = chunks_of(file.read_bytes())
    missing: list[str] = []
    with Recording(file) as recording:
        entries = read_journal(recording, missing.append)
        next(entries)
        with file.open("r+b") as stream:
            stream.truncate(chunks[len(chunks) // 2][0] + 20)
        assert sum(1 for _ in entries) > 10
    assert missing
    assert all(
        re.search(r"it was truncated at byte \d+ while it was read", each) for each in missing
    )


def test_a_file_of_a_bag_that_says_too_much_of_it_is_no_loss(tmp_path: Path) -> None:
    """The counts per file of rosbag2 include messages that its cache dropped; its total not."""
    file = recorded(tmp_path / "run", 100)
    file.write_bytes(file.read_bytes().replace(b"robotctl ", b"somebody "))
    yaml = tmp_path / "run" / "metadata.yaml"
    yaml.write_text(re.sub(r"(    message_count:) 100\n", r"\1 120\n", yaml.read_text()))
    assert "message_count: 120" in yaml.read_text()
    assert read_info(tmp_path / "run").missing == ()
    yaml.write_text(
        re.sub(r"\n  message_count: 100\n", r"\n  message_count: 120\n", yaml.read_text())
    )
    assert read_info(tmp_path / "run").missing == (
        "metadata.yaml counts 120 messages, and 100 are there",
    )


EVENTS = (
    RecordedEvent(EventKind.MARK, START_NS, "door \x1b[2J open"),
    RecordedEvent(EventKind.EMERGENCY_STOP, START_NS + 1, "requested"),
    RecordedEvent(EventKind.ERROR, START_NS + 2, ""),
    RecordedEvent(EventKind.DRIVE_ENDED, START_NS + 3, "drive finished: 2 laps", 2, 0.021),
    RecordedEvent(
        EventKind.DRIVE_ENDED, START_NS + 4, "drive finished: 1 lap", 1, 0.02, 0.01, 0.03
    ),
    RecordedEvent(
        EventKind.DRIVE_ENDED,
        START_NS + 5,
        "drive finished: 1 lap",
        1,
        0.02,
        closure_m=0.03,
        true_heading_max_rad=0.1,
        true_closure_m=0.04,
        drive_s=17.25,
    ),
)


def test_an_event_is_found_while_the_file_grows_and_after_it_was_closed(tmp_path: Path) -> None:
    recorder = Tape(tmp_path / "run")
    recorder.commands(range(1, 11))
    for event in EVENTS:
        recorder.add_event(event)
    until(lambda: read_info(tmp_path / "run").events == EVENTS)
    file = recorder.close().file
    assert read_info(tmp_path / "run").events == EVENTS
    assert len(read_strictly(file)) == 10
    file.write_bytes(file.read_bytes()[:-30])
    info = read_info(file)
    assert (info.indexed, info.events) == (False, EVENTS)


def test_events_without_end_go_on_in_another_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bag_writer, "MAX_EVENTS", 5)
    recorder = Tape(tmp_path / "run")
    events = [RecordedEvent(EventKind.MARK, START_NS + n, str(n)) for n in range(12)]
    for event in events:
        recorder.add_event(event)
    recorder.close()
    assert len(list((tmp_path / "run").glob("*.mcap"))) == 3
    assert list(read_info(tmp_path / "run").events) == events


@for_each(
    "damage",
    [
        {"kind": "holiday"},
        {"log_ns": "-1"},
        {"log_ns": "1" * 30},
        {"log_ns": "soon"},
        {"laps": "1e9"},
        {"laps": str(10**9)},
        {"cross_track_max_m": "nan"},
        {"true_cross_track_rms_m": "inf"},
        {"true_cross_track_max_m": "far"},
        {"true_closure_m": "nan"},
    ],
)
def test_what_is_no_event_of_ours_is_passed_over(damage: dict[str, str]) -> None:
    values = dict(EVENTS[3].values())
    records = [Metadata(EVENT_RECORD, {**values, **damage}), Metadata(EVENT_RECORD, {})]
    assert events_in([*records, Metadata(EVENT_RECORD, values)]) == [EVENTS[3]]
    assert events_in([Metadata("another", values)]) == []


def test_a_latched_message_that_gives_way_to_another_publisher_is_counted() -> None:
    channel = ChannelState(Topic("/map", "a/msg/A", offered_qos="durability: transient_local"))
    for number in range(MAX_LATCHED + 3):
        channel.keep_latched(bytes([number]), b"", number, 0, 0, 1000)
    assert (channel.latched_messages()[0].log_ns, channel.not_kept) == (3, 3)
