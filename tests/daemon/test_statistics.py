"""Rates, heavy topics, a diagnosis and the rows of `status` from the recorder's counts."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.daemon.host import MAX_WARNINGS
from robotctl.daemon.host import diagnose as diagnose_daemon
from robotctl.daemon.recording.recorder_report import (
    HEAVY_BYTES_PER_S,
    HEAVY_WINDOW_S,
    MAX_TOPICS,
    HeavyTopics,
    RateMeter,
    diagnose,
    topic_rows,
)
from robotctl.recording import Recorder, Topic, TopicStats
from robotctl.recording.format.topics import LATCHED_QOS
from robotctl.recording.write.bag_writer import repeats
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.writer_thread import WriterThread
from robotctl.ros.nodes.publishers import DiagnosticLevel
from tests.daemon.conftest import stats_of
from tests.support.waiting import until

S = 1_000_000_000
CAMERA, SCAN = ("/camera", "sensor_msgs/msg/Image"), ("/scan", "sensor_msgs/msg/LaserScan")
HEAVY = round(1.2 * HEAVY_BYTES_PER_S)


def topic(name: str = "/scan", type_name: str = "t", **counts: Any) -> TopicStats:
    return TopicStats(name=name, type_name=type_name, **counts)


def test_a_rate_is_that_between_the_last_two_samples() -> None:
    rates = RateMeter()
    rates.sample(10 * S, {SCAN: 100})
    rates.sample(12 * S, {SCAN: 150, CAMERA: 10})
    assert rates.rates == {SCAN: 25.0, CAMERA: 5.0}


def rates_of(sizes: Sequence[int]) -> list[float | None]:
    """Return the rate of a topic for each second in which it is heavy, else None."""
    heavy = HeavyTopics()
    rates = []
    for t, size in enumerate(sizes):
        heavy.sample(t * S, {CAMERA: size, SCAN: t * 1000})
        assert SCAN not in heavy.rates
        rates.append(heavy.rates.get(CAMERA))
    return rates


WINDOW = round(HEAVY_WINDOW_S)


def sizes_of(steps: Sequence[int]) -> list[int]:
    """Return the sizes of a topic that grows by these steps."""
    return [0, *accumulate(steps)]


def test_a_heavy_topic_is_found_once_its_window_is_full() -> None:
    rates = rates_of(sizes_of([HEAVY] * 29))
    assert rates == [None] * WINDOW + [pytest.approx(HEAVY)] * (30 - WINDOW)


def test_a_topic_that_calms_down_is_heavy_no_longer() -> None:
    rates = rates_of(sizes_of([2 * HEAVY] * 10 + [0] * 10))
    assert rates[10] is not None
    assert rates[10 + WINDOW] is None


def test_a_topic_at_the_limit_does_not_come_and_go() -> None:
    rates = rates_of(sizes_of([HEAVY] * 10 + [round(0.8 * HEAVY_BYTES_PER_S)] * 30))
    assert None not in rates[WINDOW:]


@given(st.lists(st.integers(0, 2 * HEAVY), min_size=1, max_size=40))
def test_what_is_found_was_above_the_limit_over_its_window(steps: list[int]) -> None:
    sizes = sizes_of(steps)
    means = [(sizes[t] - sizes[t - WINDOW]) / WINDOW for t in range(WINDOW, len(sizes))]
    assert any(rates_of(sizes)) == any(mean > HEAVY_BYTES_PER_S for mean in means)


def test_all_is_well_where_nothing_lacks() -> None:
    diagnosis = diagnose(stats_of(topic(received=7, written=7)), [])
    assert (diagnosis.level, diagnosis.message) == (DiagnosticLevel.OK, "everything is recorded")
    assert diagnosis.values["received"] == "7"
    assert "/scan" not in diagnosis.values


def test_what_lacks_is_named_by_topic() -> None:
    lacking = topic(received=9, written=7, dropped=2, lost=3)
    diagnosis = diagnose(stats_of(lacking, topic("/well")), [])
    assert diagnosis.level is DiagnosticLevel.WARN
    assert diagnosis.message == "2 messages dropped, 3 lost on their way here"
    assert diagnosis.values["/scan"] == diagnosis.message
    assert "/well" not in diagnosis.values


def test_a_recorder_that_failed_is_an_error_in_its_own_words() -> None:
    diagnosis = diagnose(stats_of(topic(dropped=1), failure="the disk is full"), [])
    assert (diagnosis.level, diagnosis.message) == (DiagnosticLevel.ERROR, "the disk is full")


def test_of_too_many_topics_those_that_lack_most_are_named() -> None:
    topics = [topic(f"/t{index}", dropped=index + 1) for index in range(MAX_TOPICS + 10)]
    values = diagnose(stats_of(*topics), []).values
    named = [name for name in values if name.startswith("/t")]
    assert named == [f"/t{index}" for index in reversed(range(10, MAX_TOPICS + 10))]


def test_every_warning_of_the_status_is_on_diagnostics() -> None:
    warnings = [f"topic {number} is not recorded" for number in range(MAX_WARNINGS + 5)]
    diagnosis = diagnose_daemon(warnings)
    assert diagnosis.level is DiagnosticLevel.WARN
    assert diagnosis.message == f"topic 0 is not recorded (and {MAX_WARNINGS + 4} more)"
    assert list(diagnosis.values.values()) == warnings[:MAX_WARNINGS]
    assert diagnose_daemon(warnings[:1]).message == "topic 0 is not recorded"
    assert diagnose_daemon([]).level is DiagnosticLevel.OK


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
    rows = decoded(topic_rows(topics, RATE))
    assert [(row["name"], row["type"], row["rate"]) for row in rows] == [
        ("/a", "S", 0.0),
        ("/a", "T", 0.0),
        ("/b", "T", 2.5),
    ]
    assert rows[1] | {"count": 5, "dropped": 5, "lost": 2, "unseen": 1, "bytes": 50} == rows[1]
    assert rows[2] | {"count": 4, "written": 3, "queued": 1, "throttled": 4, "bytes": 40} == rows[2]


@pytest.mark.parametrize("count", ["dropped_by_writer", "not_repeated"])
def test_what_the_writer_thread_loses_is_seen(count: str) -> None:
    state = ChannelState(Topic("/a", "T", offered_qos=LATCHED_QOS), received=1)
    if count == "not_repeated":
        state.keep_latched(GID, b"data", 1, 1, 0, room=100)
        assert repeats([state], 1, split_bytes=4) == []
        assert state.stats().not_repeated == 1
    else:
        WriterThread._drop(SimpleNamespace(_channels=[state], failure="full"), {0: 1})  # type: ignore[arg-type]
        assert state.stats().dropped == 1


def test_counts_that_the_writer_thread_changes_are_seen(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run", on_failure=pytest.fail)
    channel = recorder.add_topic(Topic("/a", "T"))
    recorder.write(channel, b"data", 1, 1, 0, GID)
    assert recorder.stats().topics[channel].queued == 1
    until(lambda: recorder.stats().topics[channel].written == 1)
    recorder.close()
