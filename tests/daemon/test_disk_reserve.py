"""Topics are throttled and watched; on a full disk the heaviest is left out, never what proves."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robotctl.config import Config, RecordingParams, flat
from robotctl.daemon.recording import recordings_folder
from robotctl.daemon.recording.flight_recorder import _evidence_topics
from robotctl.daemon.recording.recordings_folder import DiskReserve
from robotctl.daemon.recording.topic_sinks import TopicSinks
from robotctl.recording import Recorder
from robotctl.recording.write.recorder import MessageGate
from robotctl.ros.tap.tap import TopicDescription
from tests.support.waiting import loop_until

GB = 10**9
SIZES = {"/odom": 9_000_000, "/camera": 5_000_000, "/scan": 1_000_000, "/idle": 0}


def gates(*topics: str) -> dict[str, list[Any]]:
    return {topic: [SimpleNamespace(is_shut=False)] for topic in topics}


def shut(reserve_gates: dict[str, list[Any]]) -> list[str]:
    return [topic for topic, (gate,) in reserve_gates.items() if gate.is_shut]


def grown(times: int) -> dict[str, int]:
    return {topic: times * size for topic, size in SIZES.items()}


def test_the_heaviest_is_left_out_first_and_further_ones_as_the_disk_fills() -> None:
    doors = gates("/camera", "/scan", "/idle")
    reserve = DiskReserve(10 * GB, doors)
    found = []
    for look, free_gb in enumerate([11.0, 9.9, 9.5, 8.9, 7.5, 3.0]):
        reserve.look(round(free_gb * GB), grown(look))
        found.append(list(reserve.stopped))
    camera, both = ["/camera"], ["/camera", "/scan"]
    assert found == [[], camera, camera, both, both, both]
    assert shut(doors) == both


def test_everything_is_recorded_again_when_there_is_room() -> None:
    doors = gates("/camera", "/scan")
    reserve = DiskReserve(10 * GB, doors)
    reserve.look(9 * GB, grown(1))
    assert shut(doors) == ["/camera"]
    reserve.look(round(10.5 * GB), grown(2))
    assert shut(doors) == ["/camera"]
    reserve.look(11 * GB, grown(3))
    assert (shut(doors), list(reserve.warnings())) == ([], [])


def test_each_topic_that_is_left_out_is_named_with_the_reason() -> None:
    reserve = DiskReserve(10 * GB, gates("/camera"))
    reserve.look(9_990_000_000, grown(1))
    (told,) = reserve.warnings()
    assert told == (
        "/camera is not recorded: the disk has 9.99 GB free, less than 10 GB "
        "(recording.min_free_gb; see robotctl recordings rm)"
    )


async def test_a_disk_that_cannot_be_asked_is_told_as_long_as_it_lasts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings_folder, "LOOK_S", 0.01)
    reserve = DiskReserve(10 * GB, gates("/camera"))
    recorder: Any = SimpleNamespace(stats=lambda: SimpleNamespace(topics=()))
    missing = tmp_path / "gone"
    looking = asyncio.create_task(reserve.run(recorder, missing))
    await loop_until(lambda: list(reserve.warnings()))
    assert list(reserve.warnings()) == [
        f"the free space of {missing} is not known: No such file or directory"
    ]
    missing.mkdir()
    await loop_until(lambda: not list(reserve.warnings()))
    looking.cancel()


@pytest.mark.parametrize("free", [0, 5 * GB])
def test_a_topic_without_messages_is_not_left_out(free: int) -> None:
    doors = gates("/idle")
    DiskReserve(10 * GB, doors).look(free, SIZES)
    assert shut(doors) == []


LATCHED = "- durability: transient_local"
GID = bytes(16)


@pytest.fixture
def bag(tmp_path: Path) -> Iterator[Recorder]:
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
    bag: Recorder, name: str, offered_qos: str, throttled: bool
) -> None:
    sink = sinks(bag, throttle=("*=1",), min_free_gb=1.0).open(described(name, offered_qos))
    for number in range(10):
        sink(b"", number, number, number + 1, GID)
    stats = bag.stats()
    assert (stats.received, stats.throttled) == ((1, 9) if throttled else (10, 0))


def test_without_throttle_and_reserve_nothing_stands_before_the_recorder(bag: Recorder) -> None:
    assert not isinstance(sinks(bag).open(described("/camera")), MessageGate)


def test_a_topic_that_was_stopped_for_the_disk_stays_so_with_another_qos(bag: Recorder) -> None:
    made = sinks(bag, min_free_gb=1.0)
    made.open(described("/camera"))
    made.gates["/camera"][0].is_shut = True
    made.open(described("/camera", "- durability: volatile"))
    assert [each.is_shut for each in made.gates["/camera"]] == [True, True]


def test_the_topics_of_all_inputs_are_evidence() -> None:
    topics = {str(name) for key, name in flat(Config()).items() if key.endswith("topic")}
    assert {"cmd_vel", "cmd_vel_nav", "odom"} <= topics - {""} <= set(_evidence_topics(Config()))
