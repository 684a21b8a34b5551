"""What `topic echo` prints is YAML that says the same as the message, and harms no terminal."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from robotctl.cli.ui.ros_text import message_lines, plain_json

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


@pytest.mark.parametrize("text", ["\x1b[2J", "a\nb", "\u202e", "\x9b31m", "é", "yes", "1", "- a"])
def test_no_text_reaches_the_terminal_as_it_is_or_becomes_something_else(text: str) -> None:
    (line,) = message_lines({"text": text})
    assert line.isprintable()
    assert yaml.safe_load(line) == {"text": text}


def test_json_holds_no_number_that_json_does_not_know() -> None:
    assert plain_json({"a": [nan, inf, 1.5], "b": b"\x01"}) == {"a": [None, None, 1.5], "b": [1]}
