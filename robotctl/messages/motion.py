"""Reads and writes odometry and Twist as CDR, fast enough for the control rate.

rclpy needs 50 us to make an Odometry object with its two covariances; reading the six numbers that
the robot needs from the bytes takes 2 us.
"""

from __future__ import annotations

import struct
from math import nan
from typing import NamedTuple

from robotctl.kernel.geometry import Pose, yaw_of
from robotctl.kernel.trigonometry import cos, sin
from robotctl.kernel.types import Odometry, Twist
from robotctl.kernel.units import NS_PER_S
from robotctl.messages.cdr import BODY, ENCAPSULATION, LITTLE_ENDIAN, CdrReader, CdrWriter

_TWIST = struct.Struct("<4s6d")
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_VELOCITY = struct.Struct("<6d")
_COVARIANCES = 36
_SAMPLE = struct.Struct("<2d8x4d288xd32xd")
"""Position x y, orientation x y z w, linear velocity x, angular velocity z; the rest is skipped."""


UNREADABLE = Odometry(Pose(nan, nan, nan), Twist(nan, nan), 0)
"""Replaces a message that cannot be read: the kernel drops it because it is not finite."""


class Sample(NamedTuple):
    """The numbers of an odometry sample: [m], [rad], [m/s], [rad/s], [ns]."""

    x: float
    y: float
    theta: float
    linear: float
    angular: float
    stamp_ns: int


_new = tuple.__new__
"""Makes a named tuple in a third of the time that its class needs."""


def sample_of(odometry: Odometry) -> Sample:
    """Return the numbers of an odometry value of the kernel."""
    pose, velocity = odometry.pose, odometry.velocity
    linear, angular = velocity.linear, velocity.angular
    return _new(Sample, (pose.x, pose.y, pose.theta, linear, angular, odometry.stamp_ns))


def read_sample(data: bytes) -> Sample:
    """Return the numbers of serialized odometry, those of `UNREADABLE` if it cannot be read."""
    try:
        return _new(Sample, _decode(data))
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return sample_of(UNREADABLE)


def read_odometry(data: bytes) -> Odometry:
    """Return serialized odometry as the kernel gets it, `UNREADABLE` if it cannot be read."""
    try:
        x, y, theta, linear, angular, stamp_ns = _decode(data)
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return UNREADABLE
    return Odometry(Pose(x, y, theta), Twist(linear, angular), stamp_ns)


def _decode(data: bytes) -> tuple[float, float, float, float, float, int]:
    """Return the numbers of a Sample.

    Raises:
        struct.error: The message is cut short, or not in plain CDR.
    """
    if data[:2] != LITTLE_ENDIAN:
        return _read_odometry(CdrReader(data))
    seconds, nanoseconds = _STAMP.unpack_from(data, BODY)
    x, y, qx, qy, qz, qw, linear, angular = _SAMPLE.unpack_from(data, _pose_offset(data))
    return x, y, yaw_of(qx, qy, qz, qw), linear, angular, seconds * NS_PER_S + nanoseconds


def decode_twist(data: bytes) -> Twist:
    """Return forward and turning velocity of a serialized geometry_msgs/Twist.

    Raises:
        struct.error: The message is cut short, or not in plain CDR.
    """
    if data[:2] != LITTLE_ENDIAN:
        linear, _, _, _, _, angular = CdrReader(data).take("d", 6)
    else:
        _, linear, _, _, _, _, angular = _TWIST.unpack_from(data)
    return Twist(linear, angular)


def encode_twist(twist: Twist) -> bytes:
    """Return a serialized geometry_msgs/Twist with this linear.x and angular.z; the rest is 0."""
    return _TWIST.pack(ENCAPSULATION, twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)


class StampedTwistEncoder:
    """Serializes geometry_msgs/TwistStamped messages of one frame: only the numbers change."""

    def __init__(self, frame_id: str) -> None:
        writer = _begun(frame_id)
        writer.put("d", *[0.0] * 6)
        self._buffer = writer.data
        self._twist = len(self._buffer) - _VELOCITY.size

    def encode(self, twist: Twist, stamp_ns: int) -> bytes:
        """Return a message with this linear.x and angular.z; `stamp_ns` is in ROS time."""
        buffer = self._buffer
        _STAMP.pack_into(buffer, BODY, *divmod(stamp_ns, NS_PER_S))
        _VELOCITY.pack_into(buffer, self._twist, twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)
        return bytes(buffer)


def decode_twist_stamped(data: bytes) -> Twist:
    """Return forward and turning velocity of a serialized geometry_msgs/TwistStamped.

    Raises:
        struct.error: The message is cut short, or not in plain CDR.
    """
    message = CdrReader(data)
    message.skip_header()
    linear, _, _, _, _, angular = message.take("d", 6)
    return Twist(linear, angular)


class OdometryEncoder:
    """Serializes the odometry of one robot: only the numbers change from message to message."""

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        """Encode odometry of `child_frame_id` in `frame_id`, with covariances 0: unknown."""
        writer = _begun(frame_id)
        writer.text(child_frame_id)
        self._pose = _pose_offset(writer.data)
        self._twist = self._pose + _POSE.size + 8 * _COVARIANCES
        writer.put("d", *[0.0] * (7 + _COVARIANCES + 6 + _COVARIANCES))
        self._buffer = writer.data

    def encode(self, pose: Pose, velocity: Twist, stamp_ns: int) -> bytes:
        """Return a serialized nav_msgs/Odometry."""
        buffer, half = self._buffer, pose.theta / 2.0
        _STAMP.pack_into(buffer, BODY, *divmod(stamp_ns, NS_PER_S))
        _POSE.pack_into(buffer, self._pose, pose.x, pose.y, 0.0, 0.0, 0.0, sin(half), cos(half))
        _VELOCITY.pack_into(
            buffer, self._twist, velocity.linear, 0.0, 0.0, 0.0, 0.0, velocity.angular
        )
        return bytes(buffer)


def _begun(frame_id: str) -> CdrWriter:
    """Return a writer that has written a std_msgs/Header with stamp 0."""
    writer = CdrWriter()
    writer.put("I", 0, 0)
    writer.text(frame_id)
    return writer


FRAME_AT = BODY + _STAMP.size
"""The offset of the frame_id in a message that begins with a header."""


def frame_bytes(data: bytes) -> bytes:
    """Return the serialized frame_id, with its length, of a message that begins with a header."""
    (length,) = _LENGTH.unpack_from(data, FRAME_AT) if len(data) >= FRAME_AT + 4 else (0,)
    return data[FRAME_AT : FRAME_AT + _LENGTH.size + length]


def frame_id_of(data: bytes) -> str:
    """Return the frame_id of a message that begins with a header, "" if it is not little endian."""
    if data[:2] != LITTLE_ENDIAN:
        return ""
    return frame_bytes(data)[_LENGTH.size :].removesuffix(b"\0").decode(errors="replace")


def _pose_offset(data: bytes | bytearray) -> int:
    """Return the offset of the pose in a serialized Odometry: after stamp and two frame names."""
    (length,) = _LENGTH.unpack_from(data, BODY + _STAMP.size)
    child = _STAMP.size + _LENGTH.size + length
    child += -child % 4
    (length,) = _LENGTH.unpack_from(data, BODY + child)
    end: int = child + _LENGTH.size + length
    return BODY + end + -end % 8


def _read_odometry(message: CdrReader) -> tuple[float, float, float, float, float, int]:
    (seconds,), (nanoseconds,) = message.take("i"), message.take("I")
    for _ in range(2):
        message.octets(*message.take("I"))
    x, y, _, qx, qy, qz, qw = message.take("d", 7)
    linear, _, _, _, _, angular = message.take("d", _COVARIANCES + 6)[_COVARIANCES:]
    return x, y, yaw_of(qx, qy, qz, qw), linear, angular, seconds * NS_PER_S + nanoseconds
