"""Any message is read and written by its definition, as rclpy reads and writes it."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from rclpy.serialization import deserialize_message, serialize_message

import tests.support.rosidl_parser  # noqa: F401
from robotctl.cdr.definition import UnreadableType, parse_definition
from robotctl.cdr.field_path import parse_path, value_at
from robotctl.cdr.given import WrongValue, filled
from robotctl.cdr.values import decode, encode, zero
from robotctl.ros.messages.type_definition import definition_of

messages = pytest.importorskip("test_msgs.msg", reason="test_msgs is not installed")
fixtures = pytest.importorskip("test_msgs.message_fixtures")

TYPES = (
    *("BasicTypes", "Constants", "Defaults", "Empty", "Strings", "WStrings", "Builtins"),
    *("Arrays", "BoundedPlainSequences", "BoundedSequences", "UnboundedSequences"),
    *("Nested", "MultiNested"),
)
ODOMETRY = "nav_msgs/msg/Odometry"
SERVICE = "robot_controller/srv/SetMode_Request"


def definition(type_name: str) -> Any:
    return parse_definition(type_name, definition_of(type_name))


@pytest.mark.parametrize("name", TYPES)
def test_values_are_those_of_rclpy_in_both_directions(name: str) -> None:
    kind, described = getattr(messages, name), definition(f"test_msgs/msg/{name}")
    for message in fixtures.get_test_msg(name):
        values = decode(described, serialize_message(message))
        assert_same(values, message)
        assert deserialize_message(encode(described, values), kind) == message


def assert_same(value: Any, message: Any) -> None:
    """Compare plain values with what rclpy holds."""
    if isinstance(value, dict):
        assert set(value) == set(message.get_fields_and_field_types())
        for name, inner in value.items():
            assert_same(inner, getattr(message, name))
    elif isinstance(message, bytes):  # a single `byte`
        assert value == message[0]
    elif isinstance(value, list | bytes):
        assert len(value) == len(message)
        for each, other in zip(value, message, strict=True):
            assert_same(each, other)
    else:
        assert value == message


def test_big_endian_is_read() -> None:
    data = b"\0\0\0\0" + struct.pack(">i", 7)
    assert decode(parse_definition("a/msg/T", "int32 x"), data) == {"x": 7}


def test_a_service_request_is_described_too() -> None:
    assert zero(definition(SERVICE), "robot_controller/SetMode_Request") == {"requested_mode": 0}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("int32", "a line that is no field"),
        ("Point p", "needs a/Point, which is not described"),
        ("T inner", "contains itself"),
        ("a/msg/T[] inner", "contains itself"),
    ],
)
def test_a_text_that_describes_no_type_is_refused(text: str, said: str) -> None:
    with pytest.raises(UnreadableType, match=said):
        parse_definition("a/msg/T", text)


def test_types_that_need_each_other_in_many_ways_are_read_at_once() -> None:
    """Without a memory of what is checked, this would take 2^60 steps."""
    line = "=" * 80
    parts = (f"{line}\nMSG: a/T{n}\nT{n + 1} x\nT{n + 1} y\n" for n in range(1, 60))
    text = f"T1 x\nT1 y\n{''.join(parts)}{line}\nMSG: a/T60\n"
    assert len(parse_definition("a/msg/T", text).types) == 61


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"\0\7\0\0abcd"])
@pytest.mark.parametrize("field", ["int64 x", "float64[] x", "string x", "uint8[] x", "E[] x"])
def test_a_message_that_is_cut_short_is_refused(field: str, data: bytes) -> None:
    described = parse_definition("a/msg/T", f"{field}\n{'=' * 80}\nMSG: a/E\n")
    with pytest.raises(struct.error):
        decode(described, data)


def test_a_path_leads_to_a_field_of_any_depth() -> None:
    described = definition(ODOMETRY)
    values = zero(described, described.root)
    values["pose"]["pose"]["position"]["x"] = 1.5
    values["pose"]["covariance"][35] = 2.5
    for path, value in (
        ("pose.pose.position.x", 1.5),
        ("pose.covariance[35]", 2.5),
        ("child_frame_id", ""),
    ):
        assert value_at(values, parse_path(described, path)) == value


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("pose.pose.positon.x", "geometry_msgs/Pose has no field 'positon': did you mean position"),
        ("twist.zzz", "has no field 'zzz': it has twist, covariance"),
        ("pose..x", "no path to a field"),
        ("child_frame_id.x", "child_frame_id is a string, which has no fields"),
        ("pose.covariance.x", r"is a float64\[36\], which has no fields"),
        ("pose.covariance[36]", "has 36 values"),
        ("pose.pose[0]", "pose.pose is a geometry_msgs/Pose: no list"),
        ("\x1b[2J", "no path to a field"),
    ],
)
def test_a_path_to_no_field_is_refused_in_a_sentence(path: str, said: str) -> None:
    with pytest.raises(WrongValue, match=said):
        parse_path(definition(ODOMETRY), path)


def test_a_path_beyond_the_end_of_a_sequence_is_refused() -> None:
    described = parse_definition("a/msg/T", "float32[] x")
    with pytest.raises(WrongValue, match=r"x has 1 values, no \[1\]"):
        value_at({"x": [1.0]}, parse_path(described, "x[1]"))


def test_given_values_replace_the_defaults() -> None:
    described = definition(ODOMETRY)
    before = zero(described, described.root)
    after = filled(described, before, {"pose": {"pose": {"position": {"x": 1}}}})
    assert after["pose"]["pose"]["position"] == {"x": 1.0, "y": 0.0, "z": 0.0}
    assert before["pose"]["pose"]["position"]["x"] == 0.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"mode": 1}, "has no field 'mode': did you mean requested_mode"),
        ({"requested_mode": 256}, "256 is not in 0 to 255 .uint8."),
        ({"requested_mode": "1"}, "'1' is no whole number"),
        ({"requested_mode": True}, "True is no whole number"),
        ({"requested_mode": None}, "None is no whole number"),
        ([1], "is not in the form"),
    ],
)
def test_a_wrong_value_is_refused_in_a_sentence(given: object, said: str) -> None:
    described = definition(SERVICE)
    with pytest.raises(WrongValue, match=said):
        filled(described, zero(described, described.root), given)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("float32 x", 1e300, "too large for float32"),
        ("float64 x", 10**400, "too large for float64"),
        ("float64 x", "a", "is no number"),
        ("bool x", 1, "neither true nor false"),
        ("string x", 1, "put it in quotes"),
        ("string<=2 x", "abc", "longer than 2"),
        ("int8[2] x", [1], "1 values, not 2"),
        ("int8[<=2] x", [1, 2, 3], "3 values, at most 2"),
        ("int8[] x", 1, "is no list"),
        ("E[] x", [1], r"x\[0\]: 1 is not in the form"),
    ],
)
def test_a_value_beyond_its_type_is_refused(field: str, value: object, said: str) -> None:
    described = parse_definition("a/msg/T", f"{field}\n{'=' * 80}\nMSG: a/E\n")
    with pytest.raises(WrongValue, match=said):
        filled(described, zero(described, described.root), {"x": value})
