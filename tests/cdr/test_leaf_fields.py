"""The leaf fields of a type are the paths under which its values are found."""

from __future__ import annotations

from itertools import islice

from robotctl.cdr.definition import Definition, parse_definition
from robotctl.cdr.field_path import parse_path, value_at
from robotctl.cdr.leaf_fields import leaf_fields
from robotctl.cdr.values import zero

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


def definition(text: str = TEXT) -> Definition:
    return parse_definition("a/msg/T", text)


def test_every_value_of_a_type_is_one_leaf_in_the_order_of_its_definition() -> None:
    paths = [leaf.path for leaf in leaf_fields(definition())]
    corners = [f"corners[{index}].{name}" for index in (0, 1) for name in "xy"]
    lists = ["route", "ranges", "rates"]
    assert paths == ["place.x", "place.y", *corners, *lists, "name", "is_on"]


def test_a_leaf_says_whether_it_is_a_number_or_a_list_of_numbers() -> None:
    leaves = list(leaf_fields(definition()))
    numbers = {leaf.path for leaf in leaves if leaf.is_number}
    assert {"place.x", "corners[1].y", "is_on"} <= numbers
    assert not numbers & {"name", "route", "ranges", "rates"}
    assert [leaf.path for leaf in leaves if leaf.is_number_list] == ["ranges", "rates"]


def test_the_steps_of_a_leaf_are_those_of_its_path_and_lead_to_its_value() -> None:
    described = definition()
    values = zero(described, described.root)
    for leaf in leaf_fields(described):
        assert parse_path(described, leaf.path) == leaf.steps
        value_at(values, leaf.steps)


def test_the_first_leaves_of_a_huge_type_come_at_once() -> None:
    huge = definition("Point[999999999] points\n=====\nMSG: a/Point\nfloat64 x\n")
    assert [leaf.path for leaf in islice(leaf_fields(huge), 2)] == ["points[0].x", "points[1].x"]


def test_a_huge_type_without_values_has_no_leaves() -> None:
    parts = ["T1[999999999] a\nT1[999999999] b\nint32 x\n"]
    parts += [f"MSG: a/T{n}\nT{n + 1}[999999999] a\nT{n + 1} b\n" for n in range(1, 50)]
    huge = definition("=====\n".join([*parts, "MSG: a/T50\nuint8 UNUSED=1\n"]))
    assert [leaf.path for leaf in leaf_fields(huge)] == ["x"]
