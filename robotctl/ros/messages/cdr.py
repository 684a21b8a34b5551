# mypy: disallow-untyped-calls=False
"""Odometry and Twist to and from CDR (OMG DDSI-RTPS 10.2), for what comes at the rate of control.

rclpy takes 50 us to make an Odometry object with its two covariances, of which the robot wants six
numbers; reading these from the bytes takes 2 us.
"""

from __future__ import annotations

import struct
from math import cos, sin

from geometry_msgs.msg import Twist as TwistMessage
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.serialization import deserialize_message, serialize_message

from robotctl.kernel.geometry import Pose, yaw_of
from robotctl.kernel.types import Odometry, Twist
from robotctl.ros.messages.convert import NS_PER_S, to_odometry, to_twist

_LITTLE_ENDIAN = b"\x00\x01"
_ENCAPSULATION = b"\x00\x01\x00\x00"
_BODY = len(_ENCAPSULATION)
"""Where the message itself begins; alignment counts from here."""

_TWIST = struct.Struct("<4s6d")
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_VELOCITY = struct.Struct("<6d")
_POSE_AND_TWIST = struct.Struct("<7d288x6d")
"""Position, orientation (x y z w), skipped 36 covariances, linear and angular velocity."""


def decode_odometry(data: bytes) -> Odometry:
    """Return what the kernel wants of a serialized nav_msgs/Odometry.

    Raises struct.error where the message is cut short.
    """
    if data[:2] != _LITTLE_ENDIAN:
        return to_odometry(deserialize_message(data, OdometryMessage))
    seconds, nanoseconds = _STAMP.unpack_from(data, _BODY)
    x, y, _, qx, qy, qz, qw, linear, _, _, _, _, angular = _POSE_AND_TWIST.unpack_from(
        data, _pose_offset(data)
    )
    return Odometry(
        Pose(x, y, yaw_of(qx, qy, qz, qw)),
        Twist(linear, angular),
        seconds * NS_PER_S + nanoseconds,
    )


def decode_twist(data: bytes) -> Twist:
    """Return forward and turning velocity of a serialized geometry_msgs/Twist.

    Raises struct.error where the message is cut short.
    """
    if data[:2] != _LITTLE_ENDIAN:
        return to_twist(deserialize_message(data, TwistMessage))
    _, linear, _, _, _, _, angular = _TWIST.unpack_from(data)
    return Twist(linear, angular)


def encode_twist(twist: Twist) -> bytes:
    """Return a serialized geometry_msgs/Twist whose other components are 0."""
    return _TWIST.pack(_ENCAPSULATION, twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)


class OdometryEncoder:
    """Serializes odometry of one robot: only the numbers change from message to message."""

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        """Encode odometry of `child_frame_id` in `frame_id`, with covariances 0: unknown."""
        message = OdometryMessage()
        message.header.frame_id = frame_id
        message.child_frame_id = child_frame_id
        self._buffer = bytearray(serialize_message(message))
        self._pose = _pose_offset(self._buffer)
        self._twist = self._pose + _POSE_AND_TWIST.size - _VELOCITY.size

    def encode(self, pose: Pose, velocity: Twist, stamp_ns: int) -> bytes:
        """Return a serialized nav_msgs/Odometry."""
        buffer, half = self._buffer, pose.theta / 2.0
        _STAMP.pack_into(buffer, _BODY, *divmod(stamp_ns, NS_PER_S))
        _POSE.pack_into(buffer, self._pose, pose.x, pose.y, 0.0, 0.0, 0.0, sin(half), cos(half))
        _VELOCITY.pack_into(
            buffer, self._twist, velocity.linear, 0.0, 0.0, 0.0, 0.0, velocity.angular
        )
        return bytes(buffer)


def _pose_offset(data: bytes | bytearray) -> int:
    """Where the pose begins in an Odometry: behind stamp and the two frame names."""
    (length,) = _LENGTH.unpack_from(data, _BODY + _STAMP.size)
    child = _STAMP.size + _LENGTH.size + length
    child += -child % 4
    (length,) = _LENGTH.unpack_from(data, _BODY + child)
    end: int = child + _LENGTH.size + length
    return _BODY + end + -end % 8
