"""Any message is read and written by its definition, as rclpy reads and writes it.

A row holds the values that decoding the whole message finds, at the paths of its columns.
The leaf fields of a type are the paths under which its values are found.
The hash of a type is the one that ROS computed when the type was built.

Messages of safety inputs are read whatever bytes arrive, in a limited time.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from itertools import islice
from math import isnan
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

import tests.support.rosidl_parser  # noqa: F401
from robotctl.check.ends import HASHES
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.messages.cdr import ENCAPSULATION
from robotctl.messages.definition import Definition, UnreadableType, parse_definition, rihs01_hash
from robotctl.messages.fields import (
    MAX_COLUMNS,
    ColumnKind,
    FlatDecoder,
    leaf_fields,
    parse_path,
    value_at,
)
from robotctl.messages.inputs import MAX_STATUSES, MAX_VALUES, reader_of
from robotctl.messages.values import WrongValue, decode, encode, filled, zero
from robotctl.recording.convert.sources import installed_definition
from robotctl.ros.messages.type_definition import definition_of
from robotctl.testing.hearing import safety_message
from tests.support.heard_drives import EVENTS

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


EVERYTHING = """\
bool flag
string name
float64 x
uint8 small
float32[3] triple
Inner inner
Nothing nothing
int16 after_nothing
wstring wide
Inner[2] pair
uint8[] image
uint8[4] key
float64[] ranges
string[] names
Inner[] many
float64[65] long
int64 last
================================================================================
MSG: p/Inner
int8 a
float64 b
================================================================================
MSG: p/Nothing
"""


def values(name: str) -> dict[str, Any]:
    def inner(a: int) -> dict[str, Any]:
        return {"a": a, "b": a / 3}

    return {
        "flag": True,
        "name": name,
        "x": 0.1,
        "small": 7,
        "triple": [1.0, 2.0, 3.0],
        "inner": inner(1),
        "nothing": {},
        "after_nothing": -5,
        "wide": "größer",
        "pair": [inner(2), inner(3)],
        "image": b"\x00\xff\x80",
        "key": b"abcd",
        "ranges": [1.5, 2.5],
        "names": ["", "b"],
        "many": [inner(4)],
        "long": [float(number) for number in range(65)],
        "last": 1 << 40,
    }


@pytest.mark.parametrize("name", ["", "a", "ab", "abc", "abcd", "abcdefgh"])
def test_a_row_holds_what_the_whole_message_holds_at_any_alignment(name: str) -> None:
    definition = parse_definition("p/msg/All", EVERYTHING)
    data = encode(definition, values(name))
    whole = decode(definition, data)
    decoder = FlatDecoder(definition)
    row = decoder.row(data)
    assert len(row) == len(decoder.columns)
    for column, value in zip(decoder.columns, row, strict=True):
        assert value == value_at(whole, parse_path(definition, column.name)), column.name


def test_short_arrays_are_spread_and_lists_keep_one_column() -> None:
    columns = {each.name: each.kind for each in decoder_of(EVERYTHING).columns}
    assert columns["triple[2]"] is ColumnKind.NUMBER
    assert columns["pair[1].b"] is ColumnKind.NUMBER
    assert columns["long"] is columns["ranges"] is columns["names"] is ColumnKind.LIST
    assert columns["image"] is columns["key"] is ColumnKind.BYTES
    assert columns["many"] is ColumnKind.NESTED
    assert columns["wide"] is columns["name"] is ColumnKind.TEXT


def test_an_empty_sequence_of_bytes_is_bytes() -> None:
    definition = parse_definition("p/msg/Image", "uint8[] data\n")
    assert FlatDecoder(definition).row(encode(definition, {"data": b""})) == [b""]


def test_big_endian_messages_are_read() -> None:
    definition = parse_definition("p/msg/Pair", "int16 a\nfloat64 b\n")
    data = b"\0\0\0\0" + struct.pack(">h6xd", 3, 0.5)
    assert FlatDecoder(definition).row(data) == [3, 0.5]


@pytest.mark.parametrize("cut", [3, 5, 40])
def test_a_message_that_is_cut_short_is_refused_of_flat(cut: int) -> None:
    definition = parse_definition("p/msg/All", EVERYTHING)
    data = encode(definition, values("abc"))
    with pytest.raises(struct.error):
        FlatDecoder(definition).row(data[:-cut])


@pytest.mark.parametrize("leaf", ["int8 x\n", ""])
def test_a_type_that_grows_with_each_level_is_refused_at_once(leaf: str) -> None:
    levels = [f"MSG: p/T{level}\nT{level + 1} a\nT{level + 1} b\n" for level in range(1, 60)]
    text = f"\n{'=' * 80}\n".join(["T1 a\nT1 b\n", *levels, f"MSG: p/T60\n{leaf}"])
    with pytest.raises(UnreadableType, match=f"at most {MAX_COLUMNS}"):
        decoder_of(text)


def decoder_of(text: str) -> FlatDecoder:
    definition: Definition = parse_definition("p/msg/All", text)
    return FlatDecoder(definition)


TEXT = """\
Point place
Point[2] corners
Point[] route
float32[] ranges
float64[3] rates
string name
bool is_on
uint8 UNUSED=7
================
MSG: a/Point
float64 x
float64 y
"""


def definition_of_leaves(text: str = TEXT) -> Definition:
    return parse_definition("a/msg/T", text)


def test_every_value_of_a_type_is_one_leaf_in_the_order_of_its_definition() -> None:
    paths = [leaf.path for leaf in leaf_fields(definition_of_leaves())]
    corners = [f"corners[{index}].{name}" for index in (0, 1) for name in "xy"]
    lists = ["route", "ranges", "rates"]
    assert paths == ["place.x", "place.y", *corners, *lists, "name", "is_on"]


def test_a_leaf_says_whether_it_is_a_number_or_a_list_of_numbers() -> None:
    leaves = list(leaf_fields(definition_of_leaves()))
    numbers = {leaf.path for leaf in leaves if leaf.is_number}
    assert {"place.x", "corners[1].y", "is_on"} <= numbers
    assert not numbers & {"name", "route", "ranges", "rates"}
    assert [leaf.path for leaf in leaves if leaf.is_number_list] == ["ranges", "rates"]


def test_the_steps_of_a_leaf_are_those_of_its_path_and_lead_to_its_value() -> None:
    described = definition_of_leaves()
    values = zero(described, described.root)
    for leaf in leaf_fields(described):
        assert parse_path(described, leaf.path) == leaf.steps
        value_at(values, leaf.steps)


def test_the_first_leaves_of_a_huge_type_come_at_once() -> None:
    huge = definition_of_leaves("Point[999999999] points\n=====\nMSG: a/Point\nfloat64 x\n")
    assert [leaf.path for leaf in islice(leaf_fields(huge), 2)] == ["points[0].x", "points[1].x"]


def test_a_huge_type_without_values_has_no_leaves() -> None:
    parts = ["T1[999999999] a\nT1[999999999] b\nint32 x\n"]
    parts += [f"MSG: a/T{n}\nT{n + 1}[999999999] a\nT{n + 1} b\n" for n in range(1, 50)]
    huge = definition_of_leaves("=====\n".join([*parts, "MSG: a/T50\nuint8 UNUSED=1\n"]))
    assert [leaf.path for leaf in leaf_fields(huge)] == ["x"]


SHARE = Path(sys.prefix) / "share"
MESSAGES = sorted(SHARE.glob("*/msg/*.json"))


def built_hash(path: Path, type_name: str) -> str:
    hashes = json.loads(path.read_text())["type_hashes"]
    return str(next(each["hash_string"] for each in hashes if each["type_name"] == type_name))


def computed(type_name: str, text: str) -> str:
    return rihs01_hash(type_name, parse_definition(type_name, text))


def test_each_installed_message_has_the_hash_that_ros_computed() -> None:
    assert len(MESSAGES) > 100
    for path in MESSAGES:
        type_name = f"{path.parts[-3]}/msg/{path.stem}"
        text = installed_definition(type_name, "")
        assert computed(type_name, text) == built_hash(path, type_name), type_name


def test_the_event_of_a_service_has_the_hash_that_ros_computed() -> None:
    for type_name, text in EVENTS.items():
        package, kind, event = type_name.split("/")
        path = SHARE / package / kind / f"{event.removesuffix('_Event')}.json"
        assert computed(type_name, text) == built_hash(path, type_name)


def test_the_types_that_a_check_reads_are_those_that_are_installed() -> None:
    for type_name, known in HASHES.items():
        text = EVENTS.get(type_name) or installed_definition(type_name, "")
        assert computed(type_name, text) == f"RIHS01_{known}", type_name


@pytest.mark.parametrize("comment", ["# said\n", "\n", "uint8 ANY=7\n"])
def test_comments_and_constants_do_not_change_it(comment: str) -> None:
    plain = "float64 x\nstring<=5 name\nbyte[3] bytes\nfloat32[<=4] more\n"
    assert computed("a/msg/T", comment + plain) == computed("a/msg/T", plain)
    assert computed("a/msg/T", "float64 y\n") != computed("a/msg/T", "float64 x\n")


HEADER = struct.pack("<4siII1s3x", ENCAPSULATION, 0, 0, 1, b"\0")
EMPTY = struct.pack("<IB3xIII", 1, 0, 0, 0, 0)
"""One diagnosis without texts, up to the number of its values."""


def value_of(kind: SafetyInput, data: bytes) -> float:
    return reader_of(kind, button=0, robot="robot")(data)[0]


@given(kind=st.sampled_from(SafetyInput), data=st.binary(max_size=200))
def test_any_bytes_are_a_value_or_unreadable(kind: SafetyInput, data: bytes) -> None:
    for each in (data, ENCAPSULATION + data, HEADER + data):
        assert isinstance(value_of(kind, each), float)


@pytest.mark.parametrize("kind", SafetyInput)
def test_a_message_that_is_cut_short_is_unreadable(kind: SafetyInput) -> None:
    data = safety_message(kind, 1.0, "motor: warm" if kind is SafetyInput.DIAGNOSTICS else "")
    assert value_of(kind, data) == 1.0
    assert isnan(value_of(kind, data[:4]))


@pytest.mark.parametrize(
    "data",
    [
        HEADER + struct.pack("<I", MAX_STATUSES + 1) + bytes(40 * MAX_STATUSES),
        HEADER + EMPTY + struct.pack("<I", MAX_VALUES + 1) + bytes(16 * MAX_VALUES),
        HEADER + EMPTY + struct.pack("<I", 0xFFFFFFFF),
    ],
)
def test_a_flood_of_diagnoses_is_unreadable_at_once(data: bytes) -> None:
    begin = time.process_time()
    assert isnan(value_of(SafetyInput.DIAGNOSTICS, data))
    assert time.process_time() - begin < 0.1
