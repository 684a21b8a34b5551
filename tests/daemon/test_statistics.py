"""Rates, heavy topics and a diagnosis from the recorder's counts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.daemon.diagnostics import MAX_WARNINGS
from robotctl.daemon.diagnostics import diagnose as diagnose_daemon
from robotctl.daemon.recording.loss_diagnosis import MAX_TOPICS, diagnose
from robotctl.daemon.recording.topic_rates import (
    HEAVY_BYTES_PER_S,
    HEAVY_WINDOW_S,
    HeavyTopics,
    RateMeter,
)
from robotctl.recording import RecorderState, RecorderStats, TopicStats
from robotctl.recording.format.topics import total
from robotctl.ros.nodes.publishers import DiagnosticLevel

S = 1_000_000_000
CAMERA, SCAN = ("/camera", "sensor_msgs/msg/Image"), ("/scan", "sensor_msgs/msg/LaserScan")
HEAVY = round(1.2 * HEAVY_BYTES_PER_S)


def topic(name: str = "/scan", type_name: str = "t", **counts: Any) -> TopicStats:
    return TopicStats(name=name, type_name=type_name, **counts)


def recorder(*topics: TopicStats, failure: str = "") -> RecorderStats:
    return RecorderStats(
        state=RecorderState.FAILED if failure else RecorderState.RECORDING,
        file=Path("/data/run_0.mcap"),
        bytes=1,
        **total(topics),
        no_memory=0,
        failure=failure,
        warning="",
        topics=topics,
    )


def test_a_rate_is_that_between_the_last_two_samples() -> None:
    rates = RateMeter()
    rates.sample(10 * S, {SCAN: 100})
    rates.sample(12 * S, {SCAN: 150, CAMERA: 10})
    assert rates.rates == {SCAN: 25.0, CAMERA: 5.0}


# Heavy topics


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


def test_a_heavy_topic_is_found_once_its_window_is_full() -> None:
    rates = rates_of([t * HEAVY for t in range(30)])
    assert rates == [None] * WINDOW + [pytest.approx(HEAVY)] * (30 - WINDOW)


def test_a_topic_that_gets_heavy_after_hours_is_found_as_fast() -> None:
    rates = rates_of([max(0, t - 100) * HEAVY for t in range(120)])
    assert [t for t, rate in enumerate(rates) if rate] == list(range(100 + WINDOW, 120))


def test_the_rate_of_a_heavy_topic_is_that_of_now() -> None:
    """The warning of a topic of 100 MB/s stayed at the 9.4 MB/s of its first second."""
    sizes = [0] * 10
    for step in [HEAVY] * 10 + [20 * HEAVY] * 10:
        sizes.append(sizes[-1] + step)
    rates = rates_of(sizes)
    assert rates[10 + WINDOW] == pytest.approx(HEAVY)
    assert rates[-1] == pytest.approx(20 * HEAVY)


def test_a_topic_that_calms_down_is_heavy_no_longer() -> None:
    sizes = [0]
    for step in [2 * HEAVY] * 10 + [0] * 10:
        sizes.append(sizes[-1] + step)
    rates = rates_of(sizes)
    assert rates[10] is not None
    assert rates[10 + WINDOW] is None


def test_a_topic_at_the_limit_does_not_come_and_go() -> None:
    sizes = [0]
    for second in range(40):
        sizes.append(sizes[-1] + round(HEAVY_BYTES_PER_S * (1.2 if second < 10 else 0.8)))
    rates = rates_of(sizes)
    assert None not in rates[WINDOW:]


def test_a_burst_is_not_heavy() -> None:
    assert not any(rates_of([0, 0, 0, 0, 0, 3 * HEAVY, *(3 * HEAVY for _ in range(20))]))


@given(st.lists(st.integers(0, 2 * HEAVY), min_size=1, max_size=40))
def test_what_is_found_was_above_the_limit_over_its_window(steps: list[int]) -> None:
    sizes = [0]
    for step in steps:
        sizes.append(sizes[-1] + step)
    means = [(sizes[t] - sizes[t - WINDOW]) / WINDOW for t in range(WINDOW, len(sizes))]
    assert any(rates_of(sizes)) == any(mean > HEAVY_BYTES_PER_S for mean in means)


# The diagnosis


def test_all_is_well_where_nothing_lacks() -> None:
    diagnosis = diagnose(recorder(topic(received=7, written=7)), [])
    assert (diagnosis.level, diagnosis.message) == (DiagnosticLevel.OK, "everything is recorded")
    assert diagnosis.values["received"] == "7"
    assert "/scan" not in diagnosis.values


def test_what_lacks_is_named_by_topic() -> None:
    lacking = topic(received=9, written=7, dropped=2, lost=3)
    diagnosis = diagnose(recorder(lacking, topic("/well")), [])
    assert diagnosis.level is DiagnosticLevel.WARN
    assert diagnosis.message == "2 messages dropped, 3 lost on their way here"
    assert diagnosis.values["/scan"] == diagnosis.message
    assert "/well" not in diagnosis.values


def test_a_warning_is_passed_on() -> None:
    diagnosis = diagnose(recorder(), ["/x is not recorded: it has type a/msg/B"])
    assert (diagnosis.level, diagnosis.message) == (
        DiagnosticLevel.WARN,
        "/x is not recorded: it has type a/msg/B",
    )


def test_a_recorder_that_failed_is_an_error_in_its_own_words() -> None:
    diagnosis = diagnose(recorder(topic(dropped=1), failure="the disk is full"), [])
    assert (diagnosis.level, diagnosis.message) == (DiagnosticLevel.ERROR, "the disk is full")


def test_of_too_many_topics_those_that_lack_most_are_named() -> None:
    topics = [topic(f"/t{index}", dropped=index + 1) for index in range(MAX_TOPICS + 10)]
    values = diagnose(recorder(*topics), []).values
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
