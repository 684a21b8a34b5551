"""robotctl.ros.executor.decoder decodes messages as rclpy does.

Messages are read and written without ROS as rclpy reads and writes them.
Only names of installed ROS interfaces are imported, whatever names are announced.
A type for serialized messages is the installed one, and brings neither its class nor numpy.
The types that services and actions imply have a schema and a class, but no .msg file.
"""

from __future__ import annotations

import inspect
import random
import struct
import sys
import threading
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy
import pytest
from ament_index_python.resources import get_resource, get_resources
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped as TwistStampedMessage
from hypothesis import given
from hypothesis import strategies as st
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
from std_srvs.srv import Trigger_Event, Trigger_Request

from robotctl.kernel.geometry import Pose, yaw_of
from robotctl.kernel.types import Odometry as KernelOdometry
from robotctl.kernel.types import Twist
from robotctl.messages.inputs import (
    UNREADABLE,
    OdometryEncoder,
    StampedTwistEncoder,
    decode_twist,
    decode_twist_stamped,
    encode_twist,
    read_odometry,
)
from robotctl.messages.installed import InstalledType, UnusableType, installed_type
from robotctl.ros.executor.decoder import decoder_of
from robotctl.ros.message_types import message_class, type_name_of
from robotctl.ros.playback import serialized_type
from tests.support.cases import for_each
from tests.support.lines import run_python


def installed_types() -> Iterator[Any]:
    for package in sorted(get_resources("rosidl_interfaces")):
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


@for_each("kind", TYPES)
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


@for_each("kind", [Odometry, JointState])
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


finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)
anything = st.floats(width=64)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=40)
stamps = st.integers(0, (2**31 - 1) * 10**9)


def bits(*values: float) -> bytes:
    """Return values as bytes to compare: NaN equals itself, and 0.0 differs from -0.0."""
    return struct.pack(f"{len(values)}d", *values)


def to_odometry(message: Any) -> KernelOdometry:
    """Return the kernel's values of rclpy's message."""
    position, q = message.pose.pose.position, message.pose.pose.orientation
    twist = message.twist.twist
    stamp = message.header.stamp
    return KernelOdometry(
        Pose(position.x, position.y, yaw_of(q.x, q.y, q.z, q.w)),
        Twist(twist.linear.x, twist.angular.z),
        stamp.sec * 10**9 + stamp.nanosec,
    )


def odometry_bits(odometry: KernelOdometry) -> tuple[bytes, int]:
    pose, velocity = odometry.pose, odometry.velocity
    numbers = bits(pose.x, pose.y, pose.theta, velocity.linear, velocity.angular)
    return numbers, odometry.stamp_ns


@given(
    frames,
    frames,
    stamps,
    st.lists(anything, min_size=8, max_size=8),
    st.lists(finite, min_size=4, max_size=4),
)
def test_odometry_of_any_frames_reads_as_rclpy_reads_it(
    frame_id: str, child_frame_id: str, stamp_ns: int, numbers: list[float], q: list[float]
) -> None:
    message = Odometry()
    message.header.frame_id, message.child_frame_id = frame_id, child_frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = numbers[:3]
    orientation.x, orientation.y, orientation.z, orientation.w = q
    twist = message.twist.twist
    twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.z = numbers[3:]
    message.pose.covariance[35] = 7.0
    serialized = serialize_message(message)

    rclpys = to_odometry(deserialize_message(serialized, Odometry))

    assert odometry_bits(read_odometry(serialized)) == odometry_bits(rclpys)


@given(st.lists(anything, min_size=6, max_size=6))
def test_a_twist_reads_as_rclpy_reads_it(numbers: list[float]) -> None:
    message = TwistMessage()
    linear, angular = message.linear, message.angular
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = numbers
    serialized = serialize_message(message)

    read, rclpys = decode_twist(serialized), deserialize_message(serialized, TwistMessage)

    assert bits(read.linear, read.angular) == bits(rclpys.linear.x, rclpys.angular.z)


@given(anything, anything)
def test_a_twist_is_written_as_rclpy_writes_it(linear: float, angular: float) -> None:
    message = TwistMessage()
    message.linear.x, message.angular.z = linear, angular

    assert encode_twist(Twist(linear, angular)) == serialize_message(message)


@given(frames, anything, anything, stamps)
def test_a_stamped_twist_is_written_and_read_as_rclpy_does(
    frame_id: str, linear: float, angular: float, stamp_ns: int
) -> None:
    message = TwistStampedMessage()
    message.header.frame_id = frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    message.twist.linear.x, message.twist.angular.z = linear, angular

    written = StampedTwistEncoder(frame_id).encode(Twist(linear, angular), stamp_ns)
    read = decode_twist_stamped(written)

    assert len(written) == len(serialize_message(message))
    header = deserialize_message(written, TwistStampedMessage).header
    assert header == message.header
    assert bits(read.linear, read.angular) == bits(linear, angular)


@given(frames, frames, st.lists(st.tuples(finite, finite, st.floats(-3.14, 3.14), finite, stamps)))
def test_odometry_written_one_after_the_other_reads_back(
    frame_id: str, child_frame_id: str, samples: list[tuple[float, float, float, float, int]]
) -> None:
    encoder = OdometryEncoder(frame_id, child_frame_id)
    for x, y, theta, speed, stamp_ns in samples:
        message = deserialize_message(
            encoder.encode(Pose(x, y, theta), Twist(speed, -speed), stamp_ns), Odometry
        )
        read = to_odometry(message)

        assert (read.pose.x, read.pose.y, read.stamp_ns) == (x, y, stamp_ns)
        assert read.pose.theta == pytest.approx(theta, abs=1e-9)
        assert read.velocity == Twist(speed, -speed)
        assert (message.header.frame_id, message.child_frame_id) == (frame_id, child_frame_id)
        assert not any([*message.pose.covariance, *message.twist.covariance])
        assert (message.pose.pose.position.z, message.twist.twist.linear.y) == (0.0, 0.0)


def test_a_big_endian_twist_reads_as_rclpy_reads_it() -> None:
    big_endian = b"\x00\x00\x00\x00" + struct.pack(">6d", 0.25, 0.0, 0.0, 0.0, 0.0, -0.5)
    rclpys = deserialize_message(big_endian, TwistMessage)

    assert decode_twist(big_endian) == Twist(rclpys.linear.x, rclpys.angular.z) == Twist(0.25, -0.5)


@given(frames, frames, st.lists(finite, min_size=13, max_size=13))
def test_big_endian_odometry_reads_as_rclpy_reads_it(
    frame_id: str, child_frame_id: str, numbers: list[float]
) -> None:
    data = bytes(4) + struct.pack(">iI", 7, 8)
    for text in (frame_id, child_frame_id):
        data += bytes(-len(data) % 4)
        data += struct.pack(">I", len(text.encode()) + 1) + text.encode() + b"\0"
    data += bytes((4 - len(data)) % 8)
    data += struct.pack(">7d288x6d288x", *numbers)

    rclpys = to_odometry(deserialize_message(data, Odometry))

    assert odometry_bits(read_odometry(data)) == odometry_bits(rclpys)


@for_each("head", [b"\0\2\0\0", b"\0\7\0\0", b"\1\1\0\0"])
def test_what_is_not_plain_cdr_is_unreadable(head: bytes) -> None:
    assert read_odometry(head + bytes(800)) is UNREADABLE
    with pytest.raises(struct.error, match="not plain CDR"):
        decode_twist(head + bytes(800))


@for_each("size", [2, 10, 20, 40, 200, 400])
def test_a_message_cut_short_is_unreadable(size: int) -> None:
    whole = OdometryEncoder("odom", "base_link").encode(Pose(0.0, 0.0, 0.0), Twist(), 0)
    assert read_odometry(whole[:size]) is UNREADABLE
    with pytest.raises(struct.error):
        decode_twist(encode_twist(Twist())[: min(size, 50)])


HOSTILE = (
    "lib2to3/__main__/X",
    "antigravity/x/X",
    "os.path/msg/X",
    "robot_controller/__main__/X",
    "std_msgs/msg/..",
    "std_msgs/../X",
    "../std_msgs/msg/String",
    "std_msgs/msg/String\n",
    "std_msgs/msg/String_Event",
    "std_msgs/msg/__class__",
    "std_msgs/__init__/String",
    "std_msgs/String",
    "std__msgs/msg/String",
    "STD_MSGS/msg/String",
    "//",
    "",
    f"std_msgs/msg/{'S' * 300}",
)
UNLISTED = (
    "os/msg/Path",
    "robotctl/msg/String",
    "std_msgs/msg/Nope",
    "std_srvs/srv/Nope_Event",
    "std_srvs/srv/Nope",
)


@for_each("name", HOSTILE + UNLISTED)
def test_no_other_name_is_imported(name: str) -> None:
    before = set(sys.modules)
    expected = "not installed" if name in UNLISTED else "not the name of a ROS type"
    with pytest.raises(UnusableType, match=expected):
        message_class(name)
    assert installed_type(name) == InstalledType("", "")
    assert set(sys.modules) == before


@given(st.text() | st.from_regex(r"[a-z_.]{1,9}/(msg|srv|action|__main__|x)/[A-Za-z_.]{1,9}"))
def test_any_text_is_a_type_or_is_named(name: str) -> None:
    before = set(sys.modules)
    with pytest.raises(UnusableType):
        message_class(name)
    assert set(sys.modules) == before


def test_what_a_service_implies_is_found_through_it() -> None:
    assert message_class("std_srvs/srv/Trigger_Event") is Trigger_Event
    assert message_class("std_srvs/srv/Trigger_Request") is Trigger_Request
    assert type_name_of(Trigger_Event) == "std_srvs/srv/Trigger_Event"


@pytest.mark.parametrize(
    "raised", ["SystemExit(3)", "KeyboardInterrupt()", "RecursionError()", "MemoryError()", "1 / 0"]
)
def test_what_loading_a_type_raises_is_a_reason_and_no_more(
    raised: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    share = tmp_path / "share" / "broken_msgs" / "msg"
    share.mkdir(parents=True)
    (share / "Broken.msg").write_text("int8 x\n")
    package = tmp_path / "broken_msgs" / "msg"
    package.mkdir(parents=True)
    text = f"raise {raised}" if "(" in raised else raised
    (package / "__init__.py").write_text(f"{text}\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(threading, "main_thread", lambda: None)
    with pytest.raises(UnusableType, match="cannot be loaded"):
        message_class("broken_msgs/msg/Broken")
    for name in [name for name in sys.modules if name.startswith("broken_msgs")]:
        del sys.modules[name]


OF_RCLPY = (
    *("_TYPE_SUPPORT", "_CREATE_ROS_MESSAGE", "_DESTROY_ROS_MESSAGE"),
    *("_CONVERT_FROM_PY", "_CONVERT_TO_PY"),
)


@for_each("package", ["std_msgs", "geometry_msgs", "robot_controller"])
def test_every_message_has_the_type_support_of_its_class(package: str) -> None:
    content, _ = get_resource("rosidl_interfaces", package)
    names = {line.partition(".")[0] for line in content.splitlines() if line.startswith("msg/")}
    assert names
    for name in names:
        generated = message_class(f"{package}/{name}").__class__
        generated.__import_type_support__()
        found = serialized_type(f"{package}/{name}").__class__
        assert [getattr(found, each) for each in OF_RCLPY] == [
            getattr(generated, each) for each in OF_RCLPY
        ]


def test_it_imports_no_numpy() -> None:
    program = (
        "import sys; from robotctl.ros.playback import serialized_type; "
        "serialized_type('nav_msgs/msg/Odometry'); print('numpy' in sys.modules)"
    )
    ran = run_python(program)
    assert ran.stdout == "False\n", ran.stderr


@for_each("name", ["std_msgs/msg/Strings", "os/msg/Path", "std_msgs/String"])
def test_a_type_that_is_not_installed_is_refused(name: str) -> None:
    with pytest.raises(UnusableType):
        serialized_type(name)


def test_each_type_of_an_action_has_a_class() -> None:
    for implied in ("", "_Goal", "_FeedbackMessage", "_SendGoal_Request", "_GetResult_Event"):
        name = f"DrivePattern{implied}"
        assert message_class(f"robot_controller/action/{name}").__name__ == name


@given(frames, frames)
def test_odometry_is_written_as_rclpy_writes_it_but_for_padding(
    frame_id: str, child_frame_id: str
) -> None:
    message = Odometry()
    message.header.frame_id, message.child_frame_id = frame_id, child_frame_id
    rclpys = serialize_message(message)

    written = OdometryEncoder(frame_id, child_frame_id).encode(Pose(0.0, 0.0, 0.0), Twist(), 0)

    assert len(written) == len(rclpys)  # rclpy leaves its padding uninitialized
    assert deserialize_message(written, Odometry) == message


def test_an_event_of_a_service_has_its_class() -> None:
    name = "std_srvs/srv/SetBool_Event"
    assert serialized_type(name) is message_class(name)
