"""The rows of `status` are those of the counts, and only what changed is encoded again."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_type_hints

import msgspec
import pytest

from robotctl.daemon.recording import topic_rows
from robotctl.daemon.recording.topic_rows import TopicRows
from robotctl.ipc.answers import TopicAnswer
from robotctl.recording import Recorder, Topic
from robotctl.recording.format.topics import COUNTERS, LATCHED_QOS, TopicStats, total
from robotctl.recording.write.bag_writer import repeats
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.recorder import CountsOfTopics
from robotctl.recording.write.writer_thread import WriterThread
from tests.support.waiting import until

GID = bytes(16)
RATE = {("/b", "T"): 2.5}


def decoded(rows: msgspec.Raw) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = msgspec.json.decode(rows)
    return found


def test_the_channels_of_a_topic_are_one_row_and_rows_are_sorted() -> None:
    topics = (
        TopicStats(received=3, written=2, queued=1, name="/b", type_name="T", bytes=30),
        TopicStats(received=5, dropped=5, lost=2, unseen=1, name="/a", type_name="T", bytes=50),
        TopicStats(received=1, written=1, throttled=4, name="/b", type_name="T", bytes=10),
        TopicStats(name="/a", type_name="S"),
    )
    rows = decoded(TopicRows().encoded(topics, RATE))
    assert [(row["name"], row["type"], row["rate"]) for row in rows] == [
        ("/a", "S", 0.0),
        ("/a", "T", 0.0),
        ("/b", "T", 2.5),
    ]
    assert rows[1] | {"count": 5, "dropped": 5, "lost": 2, "unseen": 1, "bytes": 50} == rows[1]
    assert rows[2] | {"count": 4, "written": 3, "queued": 1, "throttled": 4, "bytes": 40} == rows[2]


def test_a_row_follows_its_counts_its_rate_and_new_topics(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = TopicRows()
    encoded = list[str]()

    def encode(row: msgspec.Struct) -> bytes:
        encoded.append(row.name)  # type: ignore[attr-defined]
        return msgspec.json.encode(row)

    monkeypatch.setattr(topic_rows, "_encode", encode)
    still, moving = TopicStats(1, name="/a", type_name="T"), TopicStats(name="/b", type_name="T")
    first = rows.encoded((still, moving), {})
    moving = TopicStats(received=7, name="/b", type_name="T")
    second = rows.encoded((still, moving), {})
    assert encoded == ["/a", "/b", "/b"]
    assert [decoded(each)[1]["count"] for each in (first, second)] == [0, 7]
    assert decoded(rows.encoded((still, moving), RATE))[1]["rate"] == 2.5
    more = rows.encoded((still, moving, TopicStats(name="/aa", type_name="T")), RATE)
    assert [(row["name"], row["rate"]) for row in decoded(more)] == [
        ("/a", 0.0),
        ("/aa", 0.0),
        ("/b", 2.5),
    ]


def test_the_counts_of_a_topic_begin_with_the_counters_of_the_ledger() -> None:
    assert TopicStats._fields[: len(COUNTERS)] == COUNTERS
    assert total([TopicStats(received=3, lost=1, bytes=9), TopicStats(received=4)])["received"] == 7


def test_the_sums_follow_the_counts() -> None:
    marks, topic = bytearray(b"\1" * 100), Topic("/a", "T")
    channels = [ChannelState(topic, marks=marks, number=number) for number in range(100)]
    counts = CountsOfTopics(channels, marks)
    assert counts.sums == total(())
    for changed in (0, 3, 0, 60, 1, 100):
        channels.append(ChannelState(topic, marks=marks, number=len(channels)))
        marks.append(1)
        for state in channels[:changed]:
            state.received += 2
            state.throttled += state.number % 3
            state.mark()
        counts.update()
        assert counts.sums == total([state.stats() for state in channels])


def test_the_counts_of_a_topic_are_the_same_object_until_one_changes(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    quiet, busy = (recorder.add_topic(Topic(name, "T")) for name in ("/quiet", "/busy"))
    recorder.write(quiet, b"data", 1, 1, 0, GID)
    recorder.close()
    before = recorder.stats().topics
    assert recorder.stats().topics is recorder.stats().topics
    before = recorder.stats().topics
    recorder.write(busy, b"data", 1, 1, 5, GID)
    after = recorder.stats()
    assert after.topics[quiet] is before[quiet]
    assert (after.topics[busy].received, after.topics[busy].dropped) == (1, 1)
    recorder.leave_out(busy, 1, 6, GID)
    assert recorder.stats().topics[busy].throttled == 1


def test_a_change_is_seen_after_memory_ran_out_while_it_was_copied(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    topic, marks = Topic("/a", "T"), bytearray(b"\1\1")
    channels = [ChannelState(topic, marks=marks, number=number) for number in range(2)]
    counts = CountsOfTopics(channels, marks)
    counts.update()
    for state in channels:
        state.received += 1
        state.mark()

    def fail(_: object) -> None:
        raise MemoryError

    with monkeypatch.context() as memory:
        memory.setattr("robotctl.recording.write.recorder.total", fail)
        with pytest.raises(MemoryError):
            counts.update()
    counts.update()
    assert [each.received for each in counts.topics] == [1, 1]
    assert counts.sums == total([state.stats() for state in channels])


def test_a_topic_that_found_no_memory_hinders_no_later_one(tmp_path: Path) -> None:
    class Full(bytearray):
        def append(self, mark: Any) -> None:
            if failing:
                raise MemoryError
            super().append(mark)

    recorder, failing = Recorder(tmp_path / "run", on_failure=pytest.fail), True
    recorder._marks = recorder._counts._marks = Full()
    with pytest.raises(MemoryError):
        recorder.add_topic(Topic("/a", "T"))
    failing = False
    for name in ("/b", "/c"):
        recorder.write(recorder.add_topic(Topic(name, "T")), b"data", 1, 1, 0, GID)
    stats = recorder.close()
    assert (stats.received, stats.written, stats.queued) == (2, 2, 0)


def test_counts_that_the_writer_thread_changes_are_seen(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    channel = recorder.add_topic(Topic("/a", "T"))
    recorder.write(channel, b"data", 1, 1, 0, GID)
    assert recorder.stats().topics[channel].queued == 1
    until(lambda: recorder.stats().topics[channel].written == 1)
    recorder.close()


@pytest.mark.parametrize("count", ["dropped_by_writer", "not_repeated"])
def test_what_the_writer_thread_loses_is_seen(count: str) -> None:
    state = ChannelState(Topic("/a", "T", offered_qos=LATCHED_QOS), received=1)
    counts = CountsOfTopics([state], state.marks)
    counts.update()
    if count == "not_repeated":
        state.keep_latched(GID, b"data", 1, 1, 0, room=100)
        assert repeats([state], 1, split_bytes=4) == []
        counts.update()
        assert counts.topics[0].not_repeated == 1
    else:
        WriterThread._drop(SimpleNamespace(_channels=[state], failure="full"), {0: 1})  # type: ignore[arg-type]
        counts.update()
        assert counts.topics[0].dropped == 1


def test_a_row_has_the_fields_of_its_answer() -> None:
    (row,) = decoded(TopicRows().encoded((TopicStats(name="/a", type_name="T"),), {}))
    assert row.keys() == get_type_hints(TopicAnswer).keys()
