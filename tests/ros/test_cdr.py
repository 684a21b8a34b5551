"""Messages are read and written without ROS as rclpy reads and writes them."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from geometry_msgs.msg import Twist as TwistMessage
from geometry_msgs.msg import TwistStamped as TwistStampedMessage
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.serialization import deserialize_message, serialize_message

from robotctl.kernel.geometry import Pose, yaw_of
from robotctl.kernel.types import Odometry, Twist
from robotctl.messages.motion import (
    OdometryEncoder,
    StampedTwistEncoder,
    decode_odometry,
    decode_twist,
    decode_twist_stamped,
    encode_twist,
)

finite = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)
anything = st.floats(width=64)
frames = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=40)
stamps = st.integers(0, (2**31 - 1) * 10**9)


def bits(*values: float) -> bytes:
    """Return values as bytes to compare: NaN equals itself, and 0.0 differs from -0.0."""
    return struct.pack(f"{len(values)}d", *values)


def to_odometry(message: Any) -> Odometry:
    """Return the kernel's values of rclpy's message."""
    position, q = message.pose.pose.position, message.pose.pose.orientation
    twist = message.twist.twist
    stamp = message.header.stamp
    return Odometry(
        Pose(position.x, position.y, yaw_of(q.x, q.y, q.z, q.w)),
        Twist(twist.linear.x, twist.angular.z),
        stamp.sec * 10**9 + stamp.nanosec,
    )


def odometry_bits(odometry: Odometry) -> tuple[bytes, int]:
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
    message = OdometryMessage()
    message.header.frame_id, message.child_frame_id = frame_id, child_frame_id
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    position.x, position.y, position.z = numbers[:3]
    orientation.x, orientation.y, orientation.z, orientation.w = q
    twist = message.twist.twist
    twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.z = numbers[3:]
    message.pose.covariance[35] = 7.0
    serialized = serialize_message(message)

    rclpys = to_odometry(deserialize_message(serialized, OdometryMessage))

    assert odometry_bits(decode_odometry(serialized)) == odometry_bits(rclpys)


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


@given(frames, frames)
def test_odometry_is_written_as_rclpy_writes_it_but_for_padding(
    frame_id: str, child_frame_id: str
) -> None:
    message = OdometryMessage()
    message.header.frame_id, message.child_frame_id = frame_id, child_frame_id
    rclpys = serialize_message(message)

    written = OdometryEncoder(frame_id, child_frame_id).encode(Pose(0.0, 0.0, 0.0), Twist(), 0)

    assert len(written) == len(rclpys)  # rclpy leaves its padding uninitialized
    assert deserialize_message(written, OdometryMessage) == message


@given(frames, frames, st.lists(st.tuples(finite, finite, st.floats(-3.14, 3.14), finite, stamps)))
def test_odometry_written_one_after_the_other_reads_back(
    frame_id: str, child_frame_id: str, samples: list[tuple[float, float, float, float, int]]
) -> None:
    encoder = OdometryEncoder(frame_id, child_frame_id)
    for x, y, theta, speed, stamp_ns in samples:
        message = deserialize_message(
            encoder.encode(Pose(x, y, theta), Twist(speed, -speed), stamp_ns), OdometryMessage
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

    rclpys = to_odometry(deserialize_message(data, OdometryMessage))

    assert odometry_bits(decode_odometry(data)) == odometry_bits(rclpys)


@pytest.mark.parametrize("decode", [decode_odometry, decode_twist])
@pytest.mark.parametrize("head", [b"\0\2\0\0", b"\0\7\0\0", b"\1\1\0\0"])
def test_what_is_not_plain_cdr_is_an_error(decode: Any, head: bytes) -> None:
    with pytest.raises(struct.error, match="not plain CDR"):
        decode(head + bytes(800))


@pytest.mark.parametrize("size", [2, 10, 20, 40, 200, 400])
def test_a_message_cut_short_is_an_error(size: int) -> None:
    whole = OdometryEncoder("odom", "base_link").encode(Pose(0.0, 0.0, 0.0), Twist(), 0)

    with pytest.raises(struct.error):
        decode_odometry(whole[:size])
    with pytest.raises(struct.error):
        decode_twist(encode_twist(Twist())[: min(size, 50)])
