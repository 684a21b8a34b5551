"""Which topics are throttled and watched, also when they come a second time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from robotctl.config import RecordingParams
from robotctl.daemon.recording.topic_sinks import TopicSinks
from robotctl.recording import Recorder
from robotctl.recording.write.recorder import MessageGate
from robotctl.ros.messages.type_definition import TopicDescription

LATCHED = "- durability: transient_local"
GID = bytes(16)


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    made = Recorder(tmp_path / "run", on_failure=pytest.fail)
    yield made
    made.close()


def sinks(recorder: Recorder, **params: Any) -> TopicSinks:
    return TopicSinks(
        recorder,
        RecordingParams(**params),
        is_own={"/robotctl/journal"}.__contains__,
        is_evidence={"/odom", "/robotctl/journal"}.__contains__,
    )


def described(name: str, offered_qos: str = "") -> TopicDescription:
    return TopicDescription(name, "std_msgs/msg/String", "", "", offered_qos)


@pytest.mark.parametrize(
    ("name", "offered_qos", "throttled"),
    [
        ("/camera", "", True),
        ("/odom", "", False),
        ("/robotctl/journal", "", False),
        ("/map", LATCHED, False),
    ],
)
def test_what_a_check_needs_and_what_is_latched_is_recorded_whole(
    recorder: Recorder, name: str, offered_qos: str, throttled: bool
) -> None:
    sink = sinks(recorder, throttle=("*=1",), min_free_gb=1.0).open(described(name, offered_qos))
    for number in range(10):
        sink(b"", number, number, number + 1, GID)
    stats = recorder.stats()
    assert (stats.received, stats.throttled) == ((1, 9) if throttled else (10, 0))


def test_without_throttle_and_reserve_nothing_stands_before_the_recorder(
    recorder: Recorder,
) -> None:
    assert not isinstance(sinks(recorder).open(described("/camera")), MessageGate)


def test_a_topic_that_comes_again_is_counted_once(recorder: Recorder) -> None:
    made = sinks(recorder, expected_rates=("/scan=10",))
    for _ in range(3):
        sink = made.open(described("/scan"))
    now_s = time.monotonic()
    for look in range(1, 20):
        for number in (0, 1):
            at_ns = time.time_ns()
            sink(b"", at_ns, at_ns, 2 * look + number, GID)
        made.health.look(now_s + 0.2 * look, time.time_ns())
    assert list(made.health.warnings(now_s + 4.0)) == []


def test_a_topic_that_was_stopped_for_the_disk_stays_so_with_another_qos(
    recorder: Recorder,
) -> None:
    made = sinks(recorder, min_free_gb=1.0)
    made.open(described("/camera"))
    made.gates["/camera"][0].is_shut = True
    made.open(described("/camera", "- durability: volatile"))
    assert [each.is_shut for each in made.gates["/camera"]] == [True, True]
