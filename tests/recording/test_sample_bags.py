"""Bags that rosbag2 itself wrote can be opened, complete or truncated."""

from __future__ import annotations

import random
from pathlib import Path
from shutil import copyfile, copytree

import pytest

from robotctl.recording import read_info, read_messages
from tests.support.recordings import salvaged

SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "rosbag2"
needs_samples = pytest.mark.skipif(not SAMPLES.is_dir(), reason=f"no sample bags at {SAMPLES}")


@needs_samples
def test_a_file_that_rosbag2_names_and_that_is_not_there_is_missing(tmp_path: Path) -> None:
    copytree(SAMPLES / "split_bag", tmp_path / "bag", copy_function=copyfile)
    (tmp_path / "bag").chmod(0o755)
    (tmp_path / "bag" / "wbag_3.mcap").unlink()
    info = read_info(tmp_path / "bag")
    assert info.missing == ("wbag_3.mcap: metadata.yaml names it, but it is not there",)


@needs_samples
@pytest.mark.parametrize(
    ("name", "count", "topics"),
    [
        ("talker", 20, {"/rosout", "/parameter_events", "/topic"}),
        ("split_bag", 6074, {letter * 3 for letter in "ABCDEFGH"}),
        (
            "bag_with_topics_and_service_events",
            10,
            {
                "/test_topic1",
                "/test_topic2",
                "/test_service1/_service_event",
                "/test_service2/_service_event",
                "/events/write_split",
            },
        ),
        ("cdr_test", 7, {"/test_topic", "/array_topic"}),
    ],
)
def test_bags_of_rosbag2_open(name: str, count: int, topics: set[str]) -> None:
    info = read_info(SAMPLES / name)
    assert (info.message_count, info.missing, info.profile) == (count, (), "ros2")
    assert {topic.name for topic in info.topics} <= topics
    assert {topic.name for topic in info.topics if topic.message_count} <= topics
    messages = list(read_messages(SAMPLES / name))
    assert len(messages) == count
    times = [message.log_ns for message in messages]
    assert times == sorted(times)
    assert (times[0], times[-1]) == (info.start_ns, info.end_ns)


@needs_samples
def test_truncated_bags_of_rosbag2_give_true_messages(tmp_path: Path) -> None:
    dice = random.Random(9)
    for source in sorted(SAMPLES.glob("*/*.mcap")):
        whole = [(m.topic, m.data, m.log_ns) for m in read_messages(source)]
        data = source.read_bytes()
        path = tmp_path / "cut.mcap"
        for cut in dice.choices(range(200, len(data)), k=40):
            path.write_bytes(data[:cut])
            messages, missing = salvaged(path)
            assert {(m.topic, m.data, m.log_ns) for m in messages} <= set(whole)
            assert missing or len(messages) == len(whole)
