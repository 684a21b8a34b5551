"""`topic` and `service` on recordings; what `topic echo` prints is YAML and harms no terminal."""

from __future__ import annotations

import json
from math import inf, nan
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from robotctl.base.errors import UsageError
from robotctl.cli.commands.node import parse_words
from robotctl.cli.ui.ros_text import message_lines, plain_json
from robotctl.cli.ui.status import topic_table
from tests.cli.conftest import Cli
from tests.support.bags import Line, write_bag

RECORDING = str(Path(__file__).parents[1] / "golden" / "stopped")


def test_the_topics_of_a_recording_are_listed_with_type_and_count(cli: Cli) -> None:
    ran = cli("topic", "list", "--file", RECORDING)
    (row,) = (line.split() for line in ran.out.splitlines() if "/odom " in line)
    assert row[:2] == ["/odom", "nav_msgs/Odometry"]
    (odom,) = (
        each
        for each in cli("topic", "list", "--file", RECORDING, "--json").summary["topics"]
        if each["name"] == "/odom"
    )
    assert odom == {"name": "/odom", "types": ["nav_msgs/msg/Odometry"], "count": int(row[2])}


def test_a_recorded_message_is_yaml_after_its_time(cli: Cli) -> None:
    out = cli("topic", "echo", "--file", RECORDING, "/robot_status", "--once").succeeded()
    assert out.startswith("# 1")
    assert out.endswith("\n---\n")
    (message, _) = yaml.safe_load_all(out)
    assert message["robot_name"] == "robot"


def test_a_field_of_each_message_is_a_line_with_the_time(cli: Cli) -> None:
    ran = cli("topic", "echo", "--file", RECORDING, "odom", "pose.pose.position.x")
    lines = [list(map(float, line.split())) for line in ran.out.splitlines()]
    as_json = cli("topic", "echo", "--file", RECORDING, "odom", "pose.pose.position.x", "--json")
    told = [json.loads(line) for line in as_json.out.splitlines()]
    assert [each["value"] for each in told] == [value for _, value in lines]
    assert [time for time, _ in lines] == pytest.approx([each["time_ns"] / 1e9 for each in told])
    assert max(value for _, value in lines) > 0.2


def test_the_rate_of_a_recorded_topic_is_told(cli: Cli) -> None:
    told = cli("topic", "hz", "--file", RECORDING, "/odom", "--json").summary
    assert told["rate_hz"] == pytest.approx(50.0, rel=0.1)
    assert told["start_ns"] < told["end_ns"]
    assert "average rate: " in cli("topic", "hz", "--file", RECORDING, "/odom").out


@pytest.mark.parametrize(
    ("arguments", "exit_code", "said"),
    [
        (["echo", "--file", RECORDING, "/odomm"], 2, "did you mean /odom?"),
        (["hz", "--file", RECORDING, "/zzz"], 2, "see: robotctl topic list --file"),
        (["echo", "--file", RECORDING, "odom", "pose.pose.x"], 2, "has no field 'x'"),
        (["echo", "--file", RECORDING, "odom", "--type", "a/msg/B"], 2, "choose one: --type nav"),
        (["hz", "--file", RECORDING, "/robotctl/marks"], 4, "has 0 messages there: no rate"),
        (["echo", "/odom", "--timeout", "0"], 2, "give seconds above 0"),
        (["echo", "/od\x1bom", "--domain-id", "1"], 2, "is no name in ROS"),
        (["list", "--file", "nowhere.mcap"], 6, "nowhere.mcap"),
        (["list", "--domain-id", "233"], 2, "use 0 to 232"),
    ],
)
def test_a_wrong_argument_is_a_sentence_and_an_exit_code(
    cli: Cli, arguments: list[str], exit_code: int, said: str
) -> None:
    cli("topic", *arguments).refused(exit_code, said)


@pytest.mark.parametrize(
    ("definition", "data", "encoding", "said"),
    [
        ("string x", b"\0\1\0\0\xff\xff\xff\xff", "cdr", "a message of /x cannot be read"),
        ("Unknown x", b"\0\1\0\0", "cdr", "needs a/Unknown, which is not described"),
        ("", b"\0\1\0\0\0", "cdr", "does not describe the type a/msg/T"),
        ("string x", b"{}", "json", "has messages in json, not in cdr"),
    ],
)
def test_a_message_that_cannot_be_read_is_named(
    cli: Cli, definition: str, data: bytes, encoding: str, said: str
) -> None:
    line = Line("/x", "a/msg/T", 0.0, data, encoding=encoding, definition=definition)
    write_bag(Path("a.mcap"), [line])
    cli("topic", "echo", "--file", "a.mcap", "x").failed(6, said)


@pytest.mark.parametrize(
    ("words", "type_name", "values"),
    [
        ([], "", {}),
        (["a/srv/B"], "a/srv/B", {}),
        (["{mode: 1}"], "", {"mode": 1}),
        (["mode: 1"], "", {"mode": 1}),
        (["a/srv/B", "{x: [1, .nan]}"], "a/srv/B", None),
    ],
)
def test_the_type_of_a_service_may_be_left_out(
    words: list[str], type_name: str, values: dict[str, Any] | None
) -> None:
    found = parse_words(words)
    assert found[0] == type_name
    assert values is None or found[1] == values


@pytest.mark.parametrize(
    "words", [["{a"], ["1"], ["a", "b"], ["a/srv/B", "{}", "x"], ["!!python/x"]]
)
def test_values_that_are_no_yaml_of_fields_are_refused(words: list[str]) -> None:
    with pytest.raises(UsageError):
        parse_words(words)


SCALARS = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(allow_nan=False), st.text()
)
NAMES = st.from_regex(r"[a-z][a-z_0-9]{0,5}", fullmatch=True).filter(
    lambda name: name not in ("y", "n", "yes", "no", "on", "off", "true", "false", "null")
)
VALUES: st.SearchStrategy[Any] = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(NAMES, inner, max_size=3)),
    max_leaves=12,
)


@settings(max_examples=40)
@given(st.dictionaries(NAMES, VALUES, max_size=4))
def test_any_message_is_read_back_from_its_lines(message: dict[str, Any]) -> None:
    lines = list(message_lines(message, None))
    assert all(line.isprintable() for line in lines)
    assert yaml.safe_load("\n".join(lines)) == message


def test_it_has_the_form_of_ros2_topic_echo() -> None:
    message = {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "odom"},
        "covariance": [0.5, 1e-05],
        "points": [{"x": 1.0, "y": nan}, {"x": -inf, "y": 2.0}],
        "data": b"\x01\x02",
        "none": [],
        "empty": {},
        "text": "",
    }
    assert list(message_lines(message)) == [
        "header:",
        "  stamp:",
        "    sec: 1",
        "    nanosec: 2",
        "  frame_id: odom",
        "covariance:",
        "- 0.5",
        "- 1.0e-05",
        "points:",
        "- x: 1.0",
        "  y: .nan",
        "- x: -.inf",
        "  y: 2.0",
        "data:",
        "- 1",
        "- 2",
        "none: []",
        "empty: {}",
        "text: ''",
    ]


def test_long_lists_and_texts_are_cut_unless_all_is_wanted() -> None:
    message = {"data": bytes(200), "text": "a" * 200}
    lines = list(message_lines(message))
    assert lines[-2:] == ["- '...'", f"text: '{'a' * 128}...'"]
    assert len(lines) == 1 + 128 + 2
    assert len(list(message_lines(message, None))) == 1 + 200 + 1


def test_json_holds_no_number_that_json_does_not_know() -> None:
    assert plain_json({"a": [nan, inf, 1.5], "b": b"\x01"}) == {"a": [None, None, 1.5], "b": [1]}


@given(name=st.text(max_size=100), type_name=st.text(max_size=100))
@pytest.mark.usefixtures("wide_terminal")
def test_every_line_has_80_columns_and_the_same_ones(name: str, type_name: str) -> None:
    header, row = topic_table([(name, type_name, 12_345_678, 99_999.9)])
    assert len(row) == len(header) == 80
    assert row.endswith(" 12345678 99999.9")
