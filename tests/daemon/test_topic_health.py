"""Topics that stop, slow down, speed up or restart are named in time; others never are.

Topics are throttled and watched; on a full disk the heaviest is left out, never what proves.
"""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.node import Node
from std_msgs.msg import String

from robotctl.config import Config, RecordingParams, flat
from robotctl.daemon.recording import recordings_folder
from robotctl.daemon.recording.flight_recorder import _evidence_topics
from robotctl.daemon.recording.recordings_folder import DiskReserve
from robotctl.daemon.recording.topic_health import (
    FORGET_S,
    LOOK_S,
    MINUTE_S,
    RECENT_S,
    ROUNDS,
    TopicHealth,
)
from robotctl.daemon.recording.topic_sinks import TopicSinks
from robotctl.recording import Recorder
from robotctl.recording.write.recorder import MessageGate
from robotctl.recording.write.recorder_options import RateByTopic
from robotctl.ros.tap.tap import TopicDescription
from tests.support.ros_peer import node_in
from tests.support.waiting import loop_until, until
from tests.support.world import PATIENT, World, read_back

WALL_NS = 1_800_000_000_000_000_000
SCAN, SCAN_TYPE = "/scan", "sensor_msgs/msg/LaserScan"
OLD, NEW = b"old".ljust(16), b"new".ljust(16)
LATENCY_S = 0.05
"""The tap collects messages for this time."""


@dataclass
class Source:
    """A channel on a virtual clock: its messages have come at these times [s]."""

    times_s: list[float]
    arrived: int = 0
    newest_ns: int = 0
    expected: dict[bytes, int] = field(default_factory=dict)
    gid: bytes = OLD

    def arrive(self, now_s: float) -> None:
        while self.arrived < len(self.times_s) and self.times_s[self.arrived] <= now_s - LATENCY_S:
            self.newest_ns = WALL_NS + round(self.times_s[self.arrived] * 1e9)
            self.arrived += 1
            self.expected[self.gid] = self.expected.get(self.gid, 1) + 1


class Watched:
    """One topic under watch; `said` are the sentences with the time of the first look with each."""

    def __init__(self, times_s: Iterable[float], rates: Iterable[str] = ()) -> None:
        self.source = Source(sorted(times_s))
        self.health = TopicHealth(RateByTopic(rates), (), 0.0)
        self.health.add(SCAN, SCAN_TYPE, self.source, learns=True, now_s=0.0)
        self.now_s = 0.0
        self.said: list[tuple[float, str]] = []

    def run(self, until_s: float, look_s: Callable[[], float] = lambda: LOOK_S) -> list[str]:
        """Look until a time; return what was said at the end."""
        warnings: list[str] = []
        while self.now_s < until_s:
            step_s = look_s()
            self.now_s += step_s
            if step_s <= LOOK_S:  # else the loop stood still, and what came meanwhile still waits
                self.source.arrive(self.now_s)
            self.health.look(self.now_s, WALL_NS + round(self.now_s * 1e9))
            warnings = list(self.health.warnings(self.now_s))
            self.said += [(self.now_s, text) for text in warnings]
        return warnings

    def first(self, what: str) -> float:
        """When it was named first."""
        return next(at_s for at_s, text in self.said if what in text)


def regular(period_s: float, begin_s: float, end_s: float, jitter: float = 0.0) -> list[float]:
    """Times of regular messages; jitter is a share of the period."""
    draw = random.Random(7)
    count = int((end_s - begin_s) / period_s)
    return [begin_s + (k + jitter * (draw.random() - 0.5)) * period_s for k in range(1, count + 1)]


PERIODS = st.floats(0.002, 2.5)
JITTERS = st.sampled_from([0.0, 0.2])
FEW = settings(max_examples=20, deadline=None)


def in_time(period_s: float) -> float:
    """How long after its last message a topic may be silent unnamed; one look is lost at most."""
    return max(1.0, 3.0 * period_s) + LOOK_S


@FEW
@given(PERIODS, JITTERS)
def test_a_regular_topic_that_goes_on_is_never_named(period_s: float, jitter: float) -> None:
    watched = Watched(regular(period_s, 0.0, 140.0, jitter))
    watched.run(139.0 - 3.0 * period_s)
    assert watched.said == []


@FEW
@given(PERIODS, JITTERS)
def test_a_topic_that_stops_is_named_in_time(period_s: float, jitter: float) -> None:
    watched = Watched(regular(period_s, 0.0, 80.0, jitter))
    watched.run(95.0)
    assert watched.first("silent") - watched.source.times_s[-1] <= in_time(period_s)


@FEW
@given(PERIODS, st.sampled_from([2.1, 2.5, 4.0]))
def test_a_topic_below_half_of_its_rate_is_named_in_time(period_s: float, slower: float) -> None:
    before = regular(period_s, 0.0, 80.0)
    after = regular(slower * period_s, before[-1], 120.0)
    watched = Watched(before + after)
    watched.run(119.0)
    assert watched.said[0][0] - before[-1] <= max(1.5, 3.0 * slower * period_s) + LOOK_S
    assert watched.run(119.0) == []


@FEW
@given(PERIODS, st.sampled_from([2.0, 3.0]))
def test_a_topic_of_twice_the_rate_is_named_in_time(period_s: float, faster: float) -> None:
    before = regular(period_s, 0.0, 80.0)
    watched = Watched(before + regular(period_s / faster, before[-1], 110.0))
    watched.run(100.0)
    assert "messages a second instead of" in watched.said[0][1]
    assert watched.said[0][0] - before[-1] <= max(1.5, 3.7 * period_s) + 2 * LOOK_S


def test_messages_that_come_late_together_do_not_count_as_twice_the_rate() -> None:
    times_s = [
        max(at_s, 80.8) if 80.05 < at_s < 80.8 else at_s for at_s in regular(0.2, 0.0, 120.0)
    ]
    watched = Watched(times_s)
    watched.run(115.0)
    rates_hz = [float(text.split()[2]) for _, text in watched.said if "instead of" in text]
    assert [each for each in rates_hz if each > 5.0] == []


@FEW
@given(st.integers(0, 10_000), st.floats(0.005, 3.0))
def test_random_events_are_never_named(seed: int, mean_s: float) -> None:
    draw, at_s, times_s = random.Random(seed), 0.0, []
    while at_s < 100.0:
        at_s += draw.expovariate(1.0 / mean_s)
        times_s.append(at_s)
    watched = Watched(times_s)
    watched.run(240.0)
    if mean_s >= 0.05:  # as regular as a sensor otherwise
        assert watched.said == []


@pytest.mark.parametrize(
    "times_s",
    [
        [1.0],
        [1.0, 2.0, 3.0],
        regular(0.1, 0.0, 30.0),
        [begin + k * 0.05 for begin in range(0, 60, 5) for k in range(20)],
        [10.0 * k for k in range(12)],
        [t for k in range(9) for t in regular(0.025 if k % 2 else 0.006, 20.0 * k, 20.0 * k + 20)],
    ],
    ids=["one-shot", "three", "held for half a minute", "in bunches", "each 10 s", "two rates"],
)
def test_what_is_not_regular_for_a_minute_is_never_named(times_s: list[float]) -> None:
    watched = Watched(times_s)
    watched.run(300.0)
    assert watched.said == []


def test_an_irregular_topic_costs_nothing_after_some_minutes() -> None:
    watched = Watched([k**1.5 for k in range(60)])
    watched.run((ROUNDS + 1) * MINUTE_S + 20.0)
    assert not watched.health._active


def test_a_configured_rate_needs_no_minute() -> None:
    watched = Watched(regular(0.1, 0.0, 5.0), ["/sc*=10"])
    watched.run(4.9)
    assert watched.said == []
    (told,) = watched.run(6.2)
    assert told.startswith("/scan has been silent for 1.")
    assert told.endswith(" s (10 messages a second are expected)")


def test_a_rate_of_zero_expects_nothing() -> None:
    watched = Watched(regular(0.1, 0.0, 80.0), ["/scan=0"])
    watched.run(100.0)
    assert watched.said == []


def test_a_configured_topic_that_never_comes_is_named() -> None:
    health = TopicHealth(RateByTopic(["/scan=10"]), ["/scan"], 0.0)
    for look in range(1, 8):
        health.look(look * LOOK_S, WALL_NS)
    assert list(health.warnings(1.4)) == [
        "/scan has had no message for 1.4 s (10 messages a second are expected)"
    ]


def test_a_trouble_that_is_over_is_told_for_a_minute() -> None:
    times_s = [each for each in regular(0.1, 0.0, 200.0) if not 70.0 < each < 73.0]
    watched = Watched(times_s)
    (told,) = watched.run(80.0)
    assert told.startswith("/scan was silent for 3.")
    assert watched.run(74.0 + RECENT_S) == []


def test_a_learned_topic_that_does_not_come_back_is_forgotten() -> None:
    watched = Watched([*regular(0.1, 0.0, 80.0), *regular(0.1, 800.0, 900.0)])
    watched.run(80.0 + FORGET_S - 1.0)
    assert watched.said[-1][0] == watched.now_s
    assert watched.run(890.0) == []
    assert watched.run(902.0) != [], "it is learned again"


def test_a_loop_that_stood_still_blames_nobody() -> None:
    draw = random.Random(3)
    watched = Watched(regular(0.1, 0.0, 200.0))
    watched.run(190.0, lambda: draw.choice([LOOK_S] * 20 + [0.5, 1.7, 4.0]))
    assert watched.said == []


def test_a_wall_clock_that_is_set_blames_nobody() -> None:
    for jump_s in (-3600.0, 3600.0):
        watched = Watched(regular(0.1, 0.0, 84.0))
        watched.run(80.0)
        told: list[str] = []
        while watched.now_s < 85.4:
            assert watched.now_s > 84.5 or told == []
            watched.now_s += LOOK_S
            watched.source.arrive(watched.now_s)
            watched.health.look(watched.now_s, WALL_NS + round((watched.now_s + jump_s) * 1e9))
            told = [each for each in watched.health.warnings(watched.now_s) if "silent" in each]
        assert told != []


def test_a_publisher_that_is_replaced_was_restarted() -> None:
    watched = Watched(regular(0.1, 0.0, 100.0))
    watched.run(75.0)
    watched.source.gid = NEW
    (told,) = watched.run(76.4)
    assert told.startswith("the publisher of /scan was restarted ")
    assert watched.first("restarted") - 75.0 <= 1.0 + 2 * LOOK_S


def test_one_more_publisher_is_no_restart() -> None:
    watched = Watched(regular(0.1, 0.0, 100.0))
    watched.run(75.0)
    while watched.now_s < 80.0:
        watched.source.gid = NEW if watched.source.gid == OLD else OLD
        watched.run(watched.now_s + LOOK_S)
    assert watched.said == []


def test_what_refuses_a_start_has_no_numbers_that_change() -> None:
    names = [f"/t{number}" for number in range(7)]
    health = TopicHealth(RateByTopic(["/t*=10"]), names, 0.0)
    assert health.troubles().startswith("/t0 has no message yet, /t1 has no message yet, ")
    assert health.troubles().endswith(" and 2 more")
    watched = Watched(regular(0.1, 0.0, 5.0), ["/scan=10"])
    watched.run(4.0)
    assert watched.health.troubles() == ""
    watched.run(9.0)
    assert watched.health.troubles() == "/scan is silent"


def test_at_many_topics_some_are_named_and_the_others_counted() -> None:
    names = [f"/t{number}" for number in range(30)]
    health = TopicHealth(RateByTopic(["/t*=10"]), names, 0.0)
    health.look(0.2, WALL_NS)
    for look in range(2, 9):
        health.look(look * LOOK_S, WALL_NS)
    told = list(health.warnings(1.6))
    assert (len(told), told[-1]) == (21, "10 more topics have other rates than expected")


SCAN_HZ, CAMERA_HZ, KEPT_HZ = 20.0, 60.0, 5.0
IN_TIME_S = 1.0
SLACK_S = 1.5
"""For a busy machine: the warning is stamped by a process that may wait."""

CONFIG = f"""{PATIENT}
recording.expected_rates: {{"/scan": {SCAN_HZ:g}}}
on_topic_trouble: refuse
recording.throttle: {{"/camera/*": {KEPT_HZ:g}, "/odom": 1}}
"""


@contextmanager
def publishing(world: World, name: str, topic: str, hz: float) -> Iterator[Node]:
    """A node of another process's kind that publishes regularly until the end of the block."""
    with node_in(world.domain_id, name) as node:
        publisher = node.create_publisher(String, topic, 10)
        node.create_timer(1.0 / hz, lambda: publisher.publish(String(data="x" * 100)))
        yield node


def warnings(world: World, what: str) -> list[str]:
    return [each for each in world.status()["warnings"] if what in each]


def topic(world: World, name: str) -> dict[str, Any]:
    found = [each for each in world.status()["topics"] if each["name"] == name]
    return found[0] if found else {"count": 0, "throttled": 0}


def test_a_sensor_that_stops_is_named_and_a_throttled_recording_is_the_same(world: World) -> None:
    with publishing(world, "camera", "/camera/image", CAMERA_HZ):
        with publishing(world, "lidar", "/scan", SCAN_HZ):
            world.ok("start", "--sim", settings=CONFIG)
            until(lambda: world.here("drive", "circle").exit_code == 0)
            until(lambda: topic(world, "/camera/image")["throttled"] > 30)
            until(lambda: topic(world, "/scan")["count"] > 20)
        stopped_s = time.time()
        (told,) = until(lambda: warnings(world, "/scan has been silent"))
        world.ok("set-mode", "idle")
        world.robotctl("drive", "circle").failed(4, "/scan is silent")
        (screen,) = until(
            lambda: [line for line in world.ok("status").splitlines() if " throttled" in line]
        )
    camera, recorder = topic(world, "/camera/image"), world.status()["recorder"]
    with publishing(world, "lidar", "/scan", SCAN_HZ):
        (over,) = until(lambda: warnings(world, "/scan was silent"))
        until(lambda: warnings(world, "the publisher of /scan was restarted"))
    world.ok("stop")
    checked = world.answer("replay", "--check", str(world.recording))
    topics = read_back(world.recording)
    assert told.endswith(" s (20 messages a second are expected)")
    assert over.endswith(" s ago")
    assert camera["count"] + camera["throttled"] > 5 * camera["count"]
    assert (camera["lost"], recorder["lost"], recorder["dropped"]) == (0, 0, 0)
    assert recorder["throttled"] >= camera["throttled"]
    assert screen.split()[-1] == "throttled"
    assert [each["verdict"] for each in checked["recordings"]] == ["same"]
    assert len(topics["/odom"]) > 60, "what a check needs is never throttled"
    for name in ("/rosout", "/diagnostics"):
        first_ns = next(
            each.log_time for each in topics[name] if b"/scan has been silent" in bytes(each.data)
        )
        assert first_ns / 1e9 - stopped_s <= IN_TIME_S + SLACK_S, name


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


def test_a_configured_topic_is_never_forgotten() -> None:
    watched = Watched(regular(0.1, 0.0, 5.0), ["/scan=10"])
    assert watched.run(2.0 * FORGET_S) != []
