"""A row holds the values that decoding the whole message finds, at the paths of its columns."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from robotctl.cdr.definition import Definition, UnreadableType, parse_definition
from robotctl.cdr.field_path import parse_path, value_at
from robotctl.cdr.flat import MAX_COLUMNS, ColumnKind, FlatDecoder
from robotctl.cdr.values import decode, encode

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
def test_a_message_that_is_cut_short_is_refused(cut: int) -> None:
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
