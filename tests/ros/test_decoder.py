"""robotctl.ros.executor.decoder decodes messages as rclpy does."""

from __future__ import annotations

import inspect
import random
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import numpy
import pytest
from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import (
    AbstractSequence,
    AbstractString,
    AbstractWString,
    Array,
    BasicType,
    NamespacedType,
)
from sensor_msgs.msg import JointState

from robotctl.ros.executor import decoder
from robotctl.ros.executor.decoder import decoder_of

PACKAGES = (
    "actionlib_msgs",
    "action_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "robot_controller",
    "rosgraph_msgs",
    "sensor_msgs",
    "service_msgs",
    "shape_msgs",
    "statistics_msgs",
    "std_msgs",
    "stereo_msgs",
    "test_msgs",
    "trajectory_msgs",
    "type_description_interfaces",
    "unique_identifier_msgs",
    "visualization_msgs",
)


def installed_types() -> Iterator[Any]:
    for package in PACKAGES:
        try:
            module = import_module(f"{package}.msg")
        except ImportError:
            continue
        yield from (
            kind for _, kind in inspect.getmembers(module, inspect.isclass) if is_message(kind)
        )


def is_message(kind: Any) -> bool:
    return hasattr(kind, "SLOT_TYPES")


TYPES = list(installed_types())

RANGES = {f"{sign}int{bits}": bits for bits in (8, 16, 32, 64) for sign in ("", "u")}


def some_value(kind: Any, dice: random.Random, depth: int = 0) -> Any:
    """Return a strategy of values for a field of this kind."""
    if isinstance(kind, BasicType):
        return some_number(kind.typename, dice)
    if isinstance(kind, AbstractString | AbstractWString):
        longest = getattr(kind, "maximum_size", None) or 12
        return "".join(dice.choices("ab \u00e9\u20ac\u4e16", k=dice.randint(0, min(longest, 12))))
    if isinstance(kind, NamespacedType):
        return some_message(getattr(import_module(".".join(kind.namespaces)), kind.name), dice)
    if isinstance(kind, Array):
        return [some_value(kind.value_type, dice) for _ in range(kind.size)]
    assert isinstance(kind, AbstractSequence)
    longest = getattr(kind, "maximum_size", None) or 3
    return [some_value(kind.value_type, dice) for _ in range(dice.randint(0, min(longest, 3)))]


def some_number(name: str, dice: random.Random) -> Any:
    if name == "boolean":
        return dice.random() < 0.5
    if name == "octet":
        return bytes([dice.randrange(256)])
    if name in ("float", "double"):
        return float(numpy.float32(dice.uniform(-1e3, 1e3)))
    bits = RANGES[name]
    return dice.randrange(2**bits) - (0 if name.startswith("u") else 2 ** (bits - 1))


def some_message(kind: Any, dice: random.Random) -> Any:
    message = kind()
    for slot, slot_kind in zip(message.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        setattr(message, slot, some_value(slot_kind, dice))
    return message


def tree(value: Any) -> Any:
    """Return the types and numbers of which a value consists."""
    if is_message(type(value)):
        fields = {name: tree(getattr(value, name)) for name in value.get_fields_and_field_types()}
        return type(value), fields
    if isinstance(value, numpy.ndarray):
        return "ndarray", value.dtype, value.flags.writeable, value.tolist()
    if isinstance(value, list):
        return [tree(item) for item in value]
    return type(value), value, getattr(value, "typecode", None)


def test_most_messages_have_a_function_of_their_own() -> None:
    everyday = [kind for kind in TYPES if not kind.__module__.startswith("test_msgs.")]
    assert len(everyday) > 150
    written = 0
    for kind in everyday:
        try:
            decoder._Source(kind, bytes).compile()
            written += 1
        except decoder._Unusual:
            pass
    assert written > 0.9 * len(everyday)


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
def test_a_message_is_made_as_rclpy_makes_it(kind: Any) -> None:
    decode = decoder_of(kind)
    dice = random.Random(kind.__name__)
    for _ in range(20):
        data = serialize_message(some_message(kind, dice))
        made, expected = decode(data), deserialize_message(data, kind)
        assert tree(made) == tree(expected)
        assert made == expected


def test_a_message_can_be_changed_without_changing_the_bytes() -> None:
    data = serialize_message(Odometry())
    made = decoder_of(Odometry)(data)
    made.pose.covariance[0] = 1.0
    made.header.frame_id = "odom"
    assert decoder_of(Odometry)(data) == Odometry()


@pytest.mark.parametrize("kind", [Odometry, JointState])
def test_a_message_that_is_cut_short_is_refused_where_rclpy_refuses_it(kind: Any) -> None:
    data = serialize_message(some_message(kind, random.Random(1)))
    refused = 0
    for size in range(len(data)):
        try:
            expected = deserialize_message(data[:size], kind)
        except Exception:  # noqa: BLE001 - rclpy has no class of its own for it
            refused += 1
            with pytest.raises(Exception, match=r".+"):
                decoder_of(kind)(data[:size])
        else:
            assert tree(decoder_of(kind)(data[:size])) == tree(expected)
    assert refused > 0.9 * len(data)


def test_big_endian_goes_to_rclpy() -> None:
    data = bytes(4) + (7).to_bytes(4) + (9).to_bytes(4)
    assert decoder_of(Time)(data) == Time(sec=7, nanosec=9)
