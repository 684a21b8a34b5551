"""A filter accepts exactly what its patterns say, and always the topics that document the drive."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robotctl.recording.write.recorder_options import TopicFilter

NAMES = st.from_regex(r"(/[a-z_][a-z0-9_]{0,3}){1,3}", fullmatch=True)
TYPES = st.sampled_from(["std_msgs/msg/String", "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"])
PATTERNS = st.one_of(
    NAMES,
    NAMES.map(lambda name: f"{name}/*"),
    st.sampled_from(["*", "/?", "/[a-f]*", "type:sensor_msgs/*", "type:std_msgs/msg/String"]),
)
LISTS = st.lists(PATTERNS, max_size=4)


@pytest.mark.parametrize(
    ("pattern", "topic", "matches"),
    [
        ("/scan", "/scan", True),
        ("/scan", "/scan2", False),
        ("/scan", "/robot/scan", False),
        ("/scan", "/Scan", False),
        ("/camera/*", "/camera/left/image", True),
        ("/camera/*", "/camera", False),
        ("/camera/*", "/camera2/image", False),
        ("*/image", "/camera/left/image", True),
        ("/joint_?", "/joint_1", True),
        ("/joint_?", "/joint_12", False),
        ("/joint_[!12]", "/joint_3", True),
        ("/joint_[!12]", "/joint_2", False),
        ("type:sensor_msgs/msg/Image", "/anything", True),
        ("type:sensor_msgs/msg/Imag", "/anything", False),
        ("type:sensor_msgs/*", "/anything", True),
        ("/sensor_msgs/msg/Image", "/anything", False),
    ],
)
def test_a_pattern_matches_what_the_page_says(pattern: str, topic: str, matches: bool) -> None:
    type_name = "sensor_msgs/msg/Image"
    assert TopicFilter(include=[pattern]).records(topic, type_name) is matches
    assert TopicFilter(exclude=[pattern]).records(topic, type_name) is not matches


@given(NAMES, TYPES)
def test_without_patterns_everything_is_recorded(topic: str, type_name: str) -> None:
    assert TopicFilter().records(topic, type_name)


@given(LISTS, LISTS, NAMES, TYPES)
def test_an_exclusion_counts_more_than_an_inclusion(
    include: list[str], exclude: list[str], topic: str, type_name: str
) -> None:
    recorded = TopicFilter(include, exclude).records(topic, type_name)
    excluded = not TopicFilter(exclude=exclude).records(topic, type_name)
    included = TopicFilter(include=include).records(topic, type_name)
    assert recorded == (included and not excluded)


@given(LISTS, LISTS, NAMES, TYPES)
def test_a_list_matches_what_any_of_its_patterns_matches_in_any_order(
    first: list[str], second: list[str], topic: str, type_name: str
) -> None:
    def excluded(patterns: list[str]) -> bool:
        return not TopicFilter(exclude=patterns).records(topic, type_name)

    assert excluded(first + second) == (excluded(first) or excluded(second))
    assert excluded(first + second) == excluded(second + first)


@given(LISTS, LISTS, NAMES, TYPES)
def test_what_proves_the_drive_is_recorded_whatever_the_patterns_say(
    include: list[str], exclude: list[str], topic: str, type_name: str
) -> None:
    chosen = TopicFilter(include, [*exclude, "*"], always=[topic])
    assert chosen.records(topic, type_name)
    assert not chosen.can_leave_out(topic)
    assert not chosen.records(f"{topic}x", type_name)
    assert chosen.can_leave_out(f"{topic}x")
