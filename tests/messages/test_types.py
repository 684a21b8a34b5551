"""Types have the fields, hashes and values that ROS gives them; rosbags reads the same.

That holds for every installed type and for drawn ones. A text or description beyond a limit, or
made to be hostile, is refused at once. Messages of safety inputs are read whatever bytes arrive.
"""

from __future__ import annotations

import dataclasses
import json
import re
import struct
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator
from math import isnan
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import tests.support.rosidl_parser  # noqa: F401
from robotctl.check.ends import HASHES
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.messages.cdr import ENCAPSULATION
from robotctl.messages.definition import (
    BUILT_IN,
    MAX_BYTES,
    MAX_DEPTH,
    MAX_FIELDS,
    MAX_LEAVES,
    MAX_LENGTH,
    MAX_TYPES,
    NUMBERS,
    Definition,
    Field,
    FieldShape,
    UnreadableType,
    description_of,
    parse_definition,
    read_description,
    rihs01_hash,
    short_type,
)
from robotctl.messages.fields import ValueKind, WrongValue, leaves, parse_path, value_at
from robotctl.messages.inputs import MAX_STATUSES, MAX_VALUES, reader_of
from robotctl.messages.installed import InstalledType, installed_type
from robotctl.messages.values import Decoder, encode, filled, zero
from robotctl.testing.hearing import safety_message
from tests.support.cases import for_each

messages = pytest.importorskip("test_msgs.msg", reason="test_msgs is not installed")
fixtures = pytest.importorskip("test_msgs.message_fixtures")

SHARE = Path(sys.prefix) / "share"
BUILT = [path for kind in ("msg", "srv", "action") for path in SHARE.glob(f"*/{kind}/*.json")]
STORE = get_typestore(Stores.EMPTY)  # of all types: to make one takes rosbags 10 ms

LINE = f"{'=' * 80}\n"
EMPTY = "structure_needs_at_least_one_member", "uint8"
"""The field that ROS gives to a type without fields."""


def without_defaults(described: Any) -> Any:
    """Return what a .json file describes, without what the hash leaves out."""
    if isinstance(described, dict):
        kept = described.items()
        return {name: without_defaults(each) for name, each in kept if name != "default_value"}
    return list(map(without_defaults, described)) if isinstance(described, list) else described


def fields_of(definition: Definition) -> dict[str, list[tuple[str, str]]]:
    """Return name and type of the fields of each type, an empty one with the field it has in C."""
    return {
        name: [(each.name, each.type_text.replace("char", "uint8")) for each in fields] or [EMPTY]
        for name, fields in definition.types.items()
    }


def assert_is_as_built(path: Path) -> None:
    """Compare all types of an interface with those that rosidl described in its .json file."""
    built = json.loads(path.read_text())
    described = built["type_description_msg"]
    root = described["type_description"]["type_name"]
    for each in built["type_hashes"]:
        name, type_hash = each["type_name"], each["hash_string"]
        read = read_description(name, described)
        assert rihs01_hash(name, read) == type_hash, name
        assert fields_of(parse_definition(name, read.text)) == fields_of(read)
    assert description_of(root, read_description(root, described)) == without_defaults(described)


def assert_rosbags_reads_the_same(name: str, text: str) -> None:
    """Compare fields and messages of a type with rosbags, which knows no wstring."""
    text = text.replace("wstring", "string")
    definition, dice = parse_definition(name, text), Random(name)
    theirs, ours = get_types_from_msg(text, name), fields_of(definition)
    assert {short_type(each) for each in theirs} == set(ours)
    for full, (_, fields) in theirs.items():
        told = [(field, text_of(kind).replace("char", "uint8")) for field, kind in fields]
        assert (told or [EMPTY]) == ours[short_type(full)], full
    root = next(iter(theirs))
    STORE.register({each: fields for each, fields in theirs.items() if each not in STORE.types})
    for _ in range(2):
        values = some(definition, Field("", definition.root), dice)
        data = encode(definition, values)
        message = STORE.deserialize_cdr(data, root)
        decoder = Decoder(definition)
        assert decoder.values(data) == values, name
        assert decoder.row(data) == [value_at(values, each.steps) for each in decoder.columns]
        assert plain(message) == plain(values), name
        assert bytes(STORE.serialize_cdr(message, root)) == data, name
        big_endian = bytes(STORE.serialize_cdr(message, root, little_endian=False))
        assert decoder.values(big_endian) == values, name


def some(definition: Definition, field: Field, dice: Random) -> Any:
    """Return a value of a field."""
    if field.shape is not FieldShape.ONE:
        most = field.length or 4
        count = most if field.shape is FieldShape.ARRAY else dice.randint(0, most)
        items = [some(definition, field.item, dice) for _ in range(count)]
        return bytes(items) if field.type_name in ("byte", "char", "uint8") else items
    if field.is_message:
        fields = definition.types[field.type_name]
        return {each.name: some(definition, each, dice) for each in fields}
    if field.is_text:
        return "".join(dice.choices("aä€😀", k=dice.randint(0, 3)))[: (field.text_bound or 60) // 4]
    code = NUMBERS[field.type_name]
    size = struct.calcsize(f"<{code}")
    data = bytes([dice.randint(0, 1)]) if code == "?" else dice.randbytes(size - 1) + b"\7"
    return struct.unpack(f"<{code}", data)[0]


def text_of(kind: Any) -> str:
    """Return a type as rosbags has it in the form of a .msg file."""
    number, content = kind
    if number == 1:
        name, bound = content
        return f"{name}<={bound}" if bound else str(name)
    if number == 2:
        return short_type(content)
    item, length = content
    return f"{text_of(item)}[{'<=' if number == 4 and length else ''}{length or ''}]"


def plain(value: Any) -> Any:
    """Return plain values, or a message of rosbags, without the field of empty types."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | bytes):
        return [plain(each) for each in value]
    if hasattr(value, "__msgtype__"):
        fields = [each.name for each in dataclasses.fields(value) if each.name[0].islower()]
        value = {name: getattr(value, name) for name in fields}
    if isinstance(value, dict):
        return {name: plain(each) for name, each in value.items() if name != EMPTY[0]}
    return value


def assert_all_are_as_built(paths: Iterable[Path]) -> int:
    """Compare the installed types with their .json files and with rosbags; return their number."""
    hashes: dict[str, str] = {}
    for path in paths:
        assert_is_as_built(path)
        built = json.loads(path.read_text())["type_hashes"]
        hashes |= {each["type_name"]: each["hash_string"] for each in built}
    for name, type_hash in hashes.items():
        text, known = installed_type(name)
        definition = parse_definition(name, text)
        assert rihs01_hash(name, definition) == known == type_hash, name
        assert re.findall("(?<=^MSG: ).*", text, re.MULTILINE) == list(definition.types)[1:]
        assert_rosbags_reads_the_same(name, text)
    return len(hashes)


@pytest.mark.parametrize("step", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_installed_types_are_what_ros_built_and_what_rosbags_reads(step: int) -> None:
    assert assert_all_are_as_built(BUILT[::step]) > 300 // step


def test_a_type_of_a_bag_is_installed_without_its_description(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in distributions before Iron, whose packages have no .json files."""
    folder = tmp_path / "share" / "old_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Old.msg").write_text("geometry_msgs/Point place\r\nuint8 A=1\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    text, type_hash = installed_type("old_msgs/msg/Old")
    assert f"uint8 A=1\n{LINE}MSG: geometry_msgs/Point\n" in text
    assert type_hash == rihs01_hash("old_msgs/msg/Old", parse_definition("old_msgs/msg/Old", text))
    (folder / "Part.msg").write_text("Absent x\n")
    assert installed_type("old_msgs/msg/Part") == InstalledType("", "")


def test_the_types_that_a_check_reads_are_those_that_are_installed() -> None:
    for type_name, known in HASHES.items():
        assert installed_type(type_name).type_hash == f"RIHS01_{known}", type_name


def drawn(dice: Random, count: int) -> Iterator[tuple[str, str]]:
    """Yield names and .msg texts of types of a package; later ones contain earlier ones."""
    known = ["geometry_msgs/Point", "std_msgs/Header", "builtin_interfaces/Time"]
    built_in = sorted(BUILT_IN)
    for number in range(count):
        lines = ["# drawn", *dice.sample(["", "uint8 A=7", "string B='a#b = c'"], k=2)]
        for place in range(dice.randrange(7)):
            kind = dice.choice(built_in if dice.random() < 0.85 else known)
            if "string" in kind and dice.random() < 0.4:
                kind += f"<={dice.randint(1, 20)}"
            kind += dice.choice(["", "", "[]", f"[{dice.randint(1, 9)}]", f"[<={place + 1}]"])
            default = " 3" if kind in ("uint16", "float64") and dice.random() < 0.3 else ""
            lines.append(f"{kind}{' ' * dice.randint(1, 3)}f{place}{default}  # {place}")
        yield f"T{number}", "\n".join(lines) + "\n"
        known = [*known[-12:], f"T{number}"]


@pytest.mark.parametrize("count", [12, pytest.param(500, marks=pytest.mark.slow)])
def test_drawn_types_are_what_rosidl_makes_of_them(
    count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    adapter = pytest.importorskip("rosidl_adapter.msg", reason="the generators are not installed")
    generator = pytest.importorskip("rosidl_generator_type_description")
    built = tmp_path / "share" / "drawn_msgs"
    (built / "msg").mkdir(parents=True)
    for name, text in drawn(Random(33), count):
        (built / "msg" / f"{name}.msg").write_text(text)
        adapter.convert_msg_to_idl(built, "drawn_msgs", Path("msg", f"{name}.msg"), built / "msg")
    arguments = {
        "package_name": "drawn_msgs",
        "output_dir": str(built),
        "idl_tuples": [f"{built}:msg/{path.name}" for path in (built / "msg").glob("*.idl")],
        "include_paths": [f"{path.name}:{path}" for path in SHARE.glob("*_*")],
    }
    (tmp_path / "arguments.json").write_text(json.dumps(arguments))
    generator.generate_type_hash(str(tmp_path / "arguments.json"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert assert_all_are_as_built((built / "msg").glob("*.json")) >= count


def chain(depth: int) -> str:
    """Return the text of a type that contains a type, and so on: `depth` types."""
    own, *others = [*(f"T{n} x\n" for n in range(1, depth)), ""]
    return LINE.join([own, *(f"MSG: a/T{n}\n{text}" for n, text in enumerate(others, 1))])


def several(types: int, fields: int) -> str:
    """Return the text of `types` types that have `fields` fields together."""
    own = "".join(f"int8 x{n}\n" for n in range(fields - types + 1))
    return LINE.join([own, *(f"MSG: a/T{n}\nint8 x\n" for n in range(1, types))])


def split(leaves: int) -> str:
    """Return the text of a type with this number of leaves, most of them in arrays."""
    arrays, rest = divmod(leaves, 64)
    own = "".join(f"T1[32] x{n}\n" for n in range(arrays)) + f"int8[{rest}] y\n" * (rest > 0)
    return f"{own}{LINE}MSG: a/T1\nint8 x\nint8 y\n"


LIMITS: dict[str, tuple[int, Callable[[int], str]]] = {
    "bytes": (MAX_BYTES, lambda n: f"int8 x\n#{' ' * (n - 8)}"),
    "bytes of other letters": (MAX_BYTES, lambda n: f"#{' ' * (n % 2 + 1)}{'é' * (n // 2 - 1)}"),
    "types": (MAX_TYPES, lambda n: several(n, n)),
    "fields of one type": (MAX_FIELDS, lambda n: several(1, n)),
    "fields of all types": (MAX_FIELDS, lambda n: several(50, n)),
    "depth": (MAX_DEPTH, chain),
    "depth by another way": (MAX_DEPTH, lambda n: f"T{n - 1} y\n{chain(n)}"),
    "length of an array": (MAX_LENGTH, lambda n: f"int8[{n}] x"),
    "length of a text": (MAX_LENGTH, lambda n: f"string<={n} x"),
    "leaves": (MAX_LEAVES, split),
}


def refusal(text: str) -> str:
    """Return why a text is refused; that takes little time and memory."""
    tracemalloc.start()
    begin_s = time.process_time()
    try:
        with pytest.raises(UnreadableType) as caught:
            parse_definition("a/msg/T0", text)
        assert time.process_time() - begin_s < 0.5
        assert tracemalloc.get_traced_memory()[1] < 6_000_000
    finally:
        tracemalloc.stop()
    return str(caught.value)


DOUBLED = LINE.join(
    [
        "T1 x\nT1 y\n",
        *(f"MSG: a/T{n}\nT{n + 1} x\nT{n + 1} y\n" for n in range(1, 60)),
        "MSG: a/T60\n",
    ]
)
"""A text with 2^60 messages in each other."""


@for_each("name", LIMITS)
def test_what_is_at_a_limit_is_read_and_one_more_is_refused_at_once(name: str) -> None:
    limit, text_with = LIMITS[name]
    read = parse_definition("a/msg/T0", text_with(limit))
    again = read_description("a/msg/T0", description_of("a/msg/T0", read))
    assert fields_of(again) == fields_of(read)
    assert str(limit) in refusal(text_with(limit + 1))


@for_each(
    ("text", "said"),
    [
        ("int32", "a line that is no field"),
        ("Point p", "needs a/Point, which is not described"),
        ("T0 inner", "contains itself"),
        ("a/msg/T0[] inner", "contains itself"),
        (f"T1 x\n{LINE}MSG: a/T1\nT2 x\n{LINE}MSG: a/T2\nT1[] x\n", "a/T1 contains itself"),
        ("int8 x\n" * 1_000_000, "longer than"),
        ("int8 x\n" * 30_000, "more than 2000 fields"),
        (f"{LINE}MSG: a/B\n" * 2_000, "more than 200 types"),
        ("=\n" * 100_000, "no field"),
        (f"int8{' ' * 250_000}", "no field"),
        (f"{'T' * 250_000}", "no field"),
        (f"int8[{'9' * 200_000}] x", "is not in 1 to"),
        (f"string<={'9' * 200_000} x", "is not in 1 to"),
        ("int8[0] x", "is not in 1 to"),
        ("int8<=5 x", "no field"),
        ("int8 \u00e4", "no field"),
        ("int8[\u0663] x", "no field"),
        ("\u00e4/T x", "no field"),
        ("int8 x\nint16 x", "two fields of the same name"),
        (DOUBLED, "more than 4096 leaves"),
        (f"T1[] x\n{LINE}MSG: a/T1\n" + "".join(f"int8[64] x{n}\n" for n in range(65)), "leaves"),
    ],
)
def test_a_text_that_describes_no_type_is_refused_at_once(text: str, said: str) -> None:
    assert said in refusal(text)


def test_constants_of_any_size_are_left_out_and_lines_may_end_as_on_windows() -> None:
    text = f"uint8 A={'9' * 200_000}\nE x\nstring B='====='\n{LINE}MSG: a/E\nint8 y\n"
    read = parse_definition("a/msg/T", text)
    assert read.text == f"a/E x\n{LINE}MSG: a/E\nint8 y\n"
    assert parse_definition("a/msg/T", text.replace("\n", "\r\n")) == read


def described(**kind: Any) -> dict[str, Any]:
    """Return the description of a/msg/T, which has one field, and of a/msg/E, which has none."""
    plain = {"type_id": 2, "capacity": 0, "string_capacity": 0, "nested_type_name": ""}
    field = {"name": kind.pop("name", "x"), "type": plain | kind}
    return {
        "type_description": {"type_name": "a/msg/T", "fields": [field]},
        "referenced_type_descriptions": [{"type_name": "a/msg/E", "fields": []}],
    }


@for_each(
    ("description", "said"),
    [
        ({}, "not in the form of ROS"),
        ({"type_description": [], "referenced_type_descriptions": [7]}, "not in the form of ROS"),
        (described(type_id="2"), "not in the form of ROS"),
        (described(type_id=12), "has no ros2msg text"),  # long double
        (described(type_id=19), "has no ros2msg text"),  # fixed string
        (described(type_id=255), "not in the form of ROS"),
        (described(type_id=1, nested_type_name="a/msg/T"), "contains itself"),
        (described(type_id=1, nested_type_name="a/msg/Other"), "which is not described"),
        (described(type_id=1, nested_type_name="E\nint8 y"), "is no name of a type"),
        (described(name="x\nint8 y"), "is no name of a field"),
        (described(name="\u00e4"), "is no name of a field"),
        (described(type_id=50), "0 is not in 1 to"),
        (described(type_id=50, capacity=2**32), "is not in 1 to"),
        (described(type_id=21, string_capacity=[2]), "is not in 1 to"),
        (described() | {"referenced_type_descriptions": [{}] * 200}, "more than 200 types"),
        (
            {"type_description": {"fields": [0] * 2001}, "referenced_type_descriptions": []},
            "more than 2000 fields",
        ),
    ],
)
def test_a_description_that_describes_no_type_is_refused(description: Any, said: str) -> None:
    with pytest.raises(UnreadableType, match=said):
        read_description("a/msg/T", description)


TYPES = (
    *("BasicTypes", "Constants", "Defaults", "Empty", "Strings", "WStrings", "Builtins", "Arrays"),
    *("BoundedPlainSequences", "BoundedSequences", "UnboundedSequences", "Nested", "MultiNested"),
)
ODOMETRY = "nav_msgs/msg/Odometry"


def definition(type_name: str) -> Definition:
    return parse_definition(type_name, installed_type(type_name).text)


@for_each("name", TYPES)
def test_values_are_those_of_rclpy_in_both_directions(name: str) -> None:
    kind, described = getattr(messages, name), definition(f"test_msgs/msg/{name}")
    for message in fixtures.get_test_msg(name):
        values = Decoder(described).values(serialize_message(message))
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


@for_each("data", [b"", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"\0\7\0\0abcd"])
@for_each("field", ["int64 x", "float64[] x", "string x", "uint8[] x", "E[] x"])
def test_a_message_that_is_cut_short_is_refused(field: str, data: bytes) -> None:
    described = parse_definition("a/msg/T", f"{field}\n{'=' * 80}\nMSG: a/E\n")
    with pytest.raises(struct.error):
        Decoder(described).values(data)


@for_each(
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
        value_at({"x": [1.0]}, parse_path(described, "x[1]").steps)


def test_given_values_replace_the_defaults() -> None:
    described = definition(ODOMETRY)
    before = zero(described, Field("", described.root))
    after = filled(described, before, {"pose": {"pose": {"position": {"x": 1}}}})
    assert after["pose"]["pose"]["position"] == {"x": 1.0, "y": 0.0, "z": 0.0}
    assert before["pose"]["pose"]["position"]["x"] == 0.0


@for_each(
    ("field", "value", "said"),
    [
        ("uint8 x", 256, "256 is not in 0 to 255 .uint8."),
        ("uint8 x", "1", "'1' is no whole number"),
        ("uint8 x", True, "True is no whole number"),
        ("uint8 x", None, "None is no whole number"),
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
        filled(described, zero(described, Field("", described.root)), {"x": value})
    with pytest.raises(WrongValue, match="has no field 'xx': did you mean x"):
        filled(described, zero(described, Field("", described.root)), {"xx": value})


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


def test_short_arrays_are_spread_and_lists_keep_one_column() -> None:
    decoder = Decoder(parse_definition("p/msg/All", EVERYTHING))
    columns = {each.name: each.kind for each in decoder.columns}
    assert columns["triple[2]"] is ValueKind.NUMBER
    assert columns["pair[1].b"] is ValueKind.NUMBER
    assert columns["long"] is columns["ranges"] is columns["names"] is ValueKind.LIST
    assert columns["image"] is columns["key"] is ValueKind.BYTES
    assert columns["many"] is ValueKind.NESTED
    assert columns["wide"] is columns["name"] is ValueKind.TEXT


def test_the_leaves_of_a_type_or_of_a_field_are_in_the_order_of_its_definition() -> None:
    described = parse_definition("p/msg/All", EVERYTHING)
    values = zero(described, Field("", described.root))
    found = list(leaves(described))
    for leaf in found:
        assert parse_path(described, leaf.name) == leaf
        value_at(values, leaf.steps)
    names = [leaf.name for leaf in found]
    assert names[:5] == ["flag", "name", "x", "small", "triple[0]"]
    pair = [f"pair[{place}].{name}" for place in (0, 1) for name in "ab"]
    assert [leaf.name for leaf in leaves(described, parse_path(described, "pair"))] == pair


HEADER = struct.pack("<4siII1s3x", ENCAPSULATION, 0, 0, 1, b"\0")
NO_TEXTS = struct.pack("<IB3xIII", 1, 0, 0, 0, 0)  # a diagnosis, up to the number of its values


def value_of(kind: SafetyInput, data: bytes) -> float:
    return reader_of(kind, button=0, robot="robot")(data)[0]


@given(kind=st.sampled_from(SafetyInput), data=st.binary(max_size=200))
def test_any_bytes_are_a_value_or_unreadable(kind: SafetyInput, data: bytes) -> None:
    for each in (data, ENCAPSULATION + data, HEADER + data):
        assert isinstance(value_of(kind, each), float)


@for_each("kind", SafetyInput)
def test_a_message_that_is_cut_short_is_unreadable(kind: SafetyInput) -> None:
    data = safety_message(kind, 1.0, "motor: warm" if kind is SafetyInput.DIAGNOSTICS else "")
    assert value_of(kind, data) == 1.0
    assert isnan(value_of(kind, data[:4]))


@for_each(
    "data",
    [
        HEADER + struct.pack("<I", MAX_STATUSES + 1) + bytes(40 * MAX_STATUSES),
        HEADER + NO_TEXTS + struct.pack("<I", MAX_VALUES + 1) + bytes(16 * MAX_VALUES),
        HEADER + NO_TEXTS + struct.pack("<I", 0xFFFFFFFF),
    ],
)
def test_a_flood_of_diagnoses_is_unreadable_at_once(data: bytes) -> None:
    begin = time.process_time()
    assert isnan(value_of(SafetyInput.DIAGNOSTICS, data))
    assert time.process_time() - begin < 0.1
