"""A throttled topic keeps the wanted rate, and every message that is left out is counted."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.recording import Recorder, Topic, read_messages
from robotctl.recording.write.recorder import MessageGate
from robotctl.recording.write.recorder_options import RateByTopic
from tests.support.recordings import read_strictly

IMAGE = Topic("/camera/image", "sensor_msgs/msg/Image")
START_NS = 1_800_000_000_000_000_000
GID = b"camera".ljust(16)


class FakeRecorder(Recorder):
    """Remembers what is kept, and writes nothing."""

    def __init__(self) -> None:
        self.kept_ns: list[int] = []
        self.left_out = 0

    def write(self, channel: int, data: object, log_ns: int, *_: object) -> None:
        self.kept_ns.append(log_ns)

    def leave_out(self, *_: object) -> None:
        self.left_out += 1


def kept(times_ns: list[int], most_hz: float) -> FakeRecorder:
    recorder = FakeRecorder()
    gate = MessageGate(recorder, 0, most_hz)
    for number, log_ns in enumerate(times_ns):
        gate(b"", log_ns, log_ns, number + 1, GID)
    return recorder


@given(st.floats(0.5, 200.0), st.floats(0.5, 200.0))
def test_a_regular_topic_keeps_the_wanted_rate(hz: float, most_hz: float) -> None:
    times_ns = [START_NS + round(number * 1e9 / hz) for number in range(2000)]
    found = kept(times_ns, most_hz)
    seconds = (times_ns[-1] - times_ns[0]) / 1e9
    assert len(found.kept_ns) == pytest.approx(seconds * min(hz, most_hz), rel=0.01, abs=1.5)
    assert len(found.kept_ns) + found.left_out == 2000


@given(st.lists(st.floats(0.0, 3.0), max_size=200), st.floats(0.5, 50.0))
def test_no_time_holds_more_than_its_share(gaps_s: list[float], most_hz: float) -> None:
    at_ns, times_ns = START_NS, []
    for gap_s in gaps_s:
        at_ns += round(gap_s * 1e9)
        times_ns.append(at_ns)
    kept_ns = kept(times_ns, most_hz).kept_ns
    for first, begin_ns in enumerate(kept_ns):
        for count, end_ns in enumerate(kept_ns[first:], 1):
            assert count <= (end_ns - begin_ns) / 1e9 * most_hz + 2.0 + 1e-6


def test_a_clock_that_is_set_back_ends_no_recording() -> None:
    times_ns = [START_NS + k * 100_000_000 for k in range(50)]
    back_ns = [each - 3600 * 1_000_000_000 for each in times_ns]
    assert len(kept(times_ns + back_ns, 5.0).kept_ns) == 50


def test_a_rate_of_zero_keeps_nothing() -> None:
    assert kept([START_NS, 2 * START_NS], 0.0).kept_ns == []


def test_a_shut_gate_keeps_nothing_until_it_opens() -> None:
    recorder = FakeRecorder()
    gate = MessageGate(recorder, 0)
    for number, is_shut in enumerate([False, True, True, False], 1):
        gate.is_shut = is_shut
        gate(b"", START_NS + number, START_NS, number, GID)
    assert recorder.kept_ns == [START_NS + 1, START_NS + 4]
    assert recorder.left_out == 2


@pytest.fixture
def recorder(tmp_path: Path) -> Recorder:
    return Recorder(tmp_path / "run", on_failure=pytest.fail)


def test_what_is_left_out_is_counted_and_not_lost(recorder: Recorder) -> None:
    gate = MessageGate(recorder, recorder.add_topic(IMAGE), 5.0)
    for number in range(300):  # 30 Hz for 10 s
        at_ns = START_NS + number * 33_333_333
        gate(b"pixels", at_ns, at_ns, number + 1, GID)
    channel = recorder.channel(0)
    stats = recorder.close()

    assert (stats.received, stats.written, stats.throttled) == (50, 50, 250)
    assert (stats.lost, stats.unseen, stats.dropped) == (0, 0, 0)
    assert (channel.arrived, channel.expected) == (300, {GID: 301})
    assert len(read_strictly(stats.file)) == 50
    times_ns = [each.log_ns for each in read_messages(stats.file)]
    gaps = [b - a for a, b in pairwise(times_ns)]
    assert max(gaps) <= 2 * min(gaps)


@pytest.mark.parametrize(
    ("topic", "type_name", "rate_hz"),
    [
        ("/camera/left", "sensor_msgs/msg/Image", 5.0),
        ("/camera/info", "sensor_msgs/msg/CameraInfo", 5.0),
        ("/rear", "sensor_msgs/msg/Image", 1.0),
        ("/scan", "sensor_msgs/msg/LaserScan", None),
    ],
)
def test_the_first_pattern_that_matches_counts(
    topic: str, type_name: str, rate_hz: float | None
) -> None:
    rates = RateByTopic(["/camera/*=5", "type:sensor_msgs/msg/Image=1", "/*/left=9"])
    assert rates.of(topic, type_name) == rate_hz
