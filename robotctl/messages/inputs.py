"""Reads the inputs of a robot from CDR, and reads and writes odometry and Twist."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import partial
from math import acos, inf, isfinite, nan, pi, tau
from typing import NamedTuple

from robotctl.base.text import short_name
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.geometry import Pose, yaw_of
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.kernel.trigonometry import cos, sin
from robotctl.kernel.types import Odometry, Twist
from robotctl.messages.cdr import BODY, ENCAPSULATION, LITTLE_ENDIAN, CdrReader, CdrWriter

_TWIST = struct.Struct("<4s6d")
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_VELOCITY = struct.Struct("<6d")
_COVARIANCES = 36
# Reading these takes 2 us; rclpy needs 50 us to make an Odometry object.
_SAMPLE = struct.Struct("<2d8x4d288xd32xd")
"""Position x y, orientation x y z w, linear velocity x, angular velocity z; the rest is skipped."""


UNREADABLE = Odometry(Pose(nan, nan, nan), Twist(nan, nan), 0)
"""The odometry of an unreadable message; its numbers are not finite."""


class Sample(NamedTuple):
    """The numbers of an odometry sample: [m], [rad], [m/s], [rad/s], [ns]."""

    x: float
    y: float
    theta: float
    linear: float
    angular: float
    stamp_ns: int


_new = tuple.__new__
"""Makes a named tuple in half the time that its class needs."""


def sample_of(odometry: Odometry) -> Sample:
    """Return `odometry` as a flat tuple of numbers."""
    pose, velocity = odometry.pose, odometry.velocity
    linear, angular = velocity.linear, velocity.angular
    return _new(Sample, (pose.x, pose.y, pose.theta, linear, angular, odometry.stamp_ns))


def read_sample(data: bytes) -> Sample:
    """Return the numbers of serialized odometry; NaN, with stamp 0, if `data` is malformed."""
    try:
        return _new(Sample, _decode(data))
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return sample_of(UNREADABLE)


def read_odometry(data: bytes) -> Odometry:
    """Return the odometry in the message `data`, `UNREADABLE` if it is malformed."""
    try:
        x, y, theta, linear, angular, stamp_ns = _decode(data)
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return UNREADABLE
    return Odometry(Pose(x, y, theta), Twist(linear, angular), stamp_ns)


def _decode(data: bytes) -> tuple[float, float, float, float, float, int]:
    """Return the numbers of a Sample; may raise struct.error."""
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
    """Return a serialized geometry_msgs/Twist; all but linear.x and angular.z is 0."""
    return _TWIST.pack(ENCAPSULATION, twist.linear, 0.0, 0.0, 0.0, 0.0, twist.angular)


class StampedTwistEncoder:
    """Serializes geometry_msgs/TwistStamped messages that share one `frame_id`."""

    def __init__(self, frame_id: str) -> None:
        writer = _begun(frame_id)
        writer.put("d", *[0.0] * 6)
        self._buffer = writer.data
        self._twist = len(self._buffer) - _VELOCITY.size

    def encode(self, twist: Twist, stamp_ns: int) -> bytes:
        """Return the serialized message for `twist`; `stamp_ns` is in ROS time."""
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
    """Serializes the odometry of one robot."""

    def __init__(self, frame_id: str, child_frame_id: str) -> None:
        """Encode odometry of `child_frame_id` in `frame_id`, with covariances 0 (unknown)."""
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
"""The offset of the frame_id in a message with a header."""


def frame_bytes(data: bytes) -> bytes:
    """Return the serialized frame_id, with its length, of a message with a header."""
    (length,) = _LENGTH.unpack_from(data, FRAME_AT) if len(data) >= FRAME_AT + 4 else (0,)
    return data[FRAME_AT : FRAME_AT + _LENGTH.size + length]


def frame_id_of(data: bytes) -> str:
    """Return the frame_id of a serialized message with a header, "" if it is big endian."""
    if data[:2] != LITTLE_ENDIAN:
        return ""
    return frame_bytes(data)[_LENGTH.size :].removesuffix(b"\0").decode(errors="replace")


def _pose_offset(data: bytes | bytearray) -> int:
    """Return the offset of the pose in a serialized Odometry."""
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


_PERCENTAGE = 6
"""The index of the level among the float32 fields that follow the header."""


def read_battery_level(data: bytes) -> float:
    """Return the level of a serialized BatteryState on its publisher's scale, NaN if unreadable."""
    try:
        message = CdrReader(data)
        message.skip_header()
        return float(message.take("f", _PERCENTAGE + 1)[_PERCENTAGE])
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return nan


SECTORS = 64
"""The number of sectors; sector n begins at -pi + n * tau / 64 in the frame of the scanner."""

MAX_RAYS = 200_000


def nearest_by_sector(data: bytes) -> tuple[float, ...]:
    """Return the nearest range in each sector [m, to 1 mm], inf for a sector without an object.

    Ranges outside range_min to range_max, and NaN, are discarded (sensor_msgs/LaserScan). By
    REP-117, -inf is an object too close to measure and becomes 0, and inf is no object.

    Raises:
        struct.error: The message is cut short, not plain CDR, has infinite angles or too many rays.
    """
    import numpy as np  # here: a check of a recording without scans need not load it

    message = CdrReader(data)
    message.skip_header()
    angle_min, _, increment, _, _, range_min, range_max = message.take("f", 7)
    (count,) = message.take("I")
    if not isfinite(angle_min + increment) or count > MAX_RAYS:
        raise struct.error(f"a scan of {count} rays from {angle_min} in steps of {increment}")
    ranges = np.array(message.take("f", count), dtype=np.float64)
    angles = angle_min + increment * np.arange(count)
    sectors = np.floor((angles + pi) % tau / tau * SECTORS).astype(np.intp) % SECTORS
    is_valid = (ranges >= range_min) & (ranges <= range_max) & np.isfinite(ranges)
    distances = np.where(ranges == -inf, 0.0, np.where(is_valid, ranges, inf))
    nearest = np.full(SECTORS, inf)
    np.minimum.at(nearest, sectors, distances)
    return tuple(round(float(each), 3) for each in nearest)


def read_sectors(data: bytes) -> tuple[float, ...]:
    """Return the nearest range in each sector, () for an unreadable message."""
    try:
        return nearest_by_sector(data)
    except struct.error:
        return ()


Reader = Callable[[bytes], tuple[float, str]]
"""Returns the number that `SafetyInput` defines, NaN if unreadable, and the sender's text or ""."""

MESSAGE_TYPES = {
    SafetyInput.ESTOP: "std_msgs/msg/Bool",
    SafetyInput.JOY: "sensor_msgs/msg/Joy",
    SafetyInput.BUMPER: "std_msgs/msg/Bool",
    SafetyInput.TILT: "sensor_msgs/msg/Imu",
    SafetyInput.DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}

MAX_DIAGNOSES = 256
"""Limit on the stored DiagnosticStatus names; beyond it, the least severe one is dropped."""

MAX_STATUSES = 2_000
"""Limit on the DiagnosticStatus entries of a readable message."""

MAX_VALUES = 20_000
"""Limit on the key-value pairs in one message, which take about 20 ms to read."""

UNIT_TOLERANCE = 0.1
"""The largest difference between the length of a quaternion and 1."""


def reader_of(kind: SafetyInput, *, button: int, robot: str) -> Reader:
    """Return a new reader of an input.

    JOY needs the number of the `button`. The reader of DIAGNOSTICS remembers earlier messages, and
    skips the statuses that robotctl sends for `robot`.
    """
    readers: dict[SafetyInput, Reader] = {
        SafetyInput.ESTOP: _bool,
        SafetyInput.JOY: partial(_button, button),
        SafetyInput.BUMPER: _bool,
        SafetyInput.TILT: _tilt,
        SafetyInput.DIAGNOSTICS: Diagnoses(robot).worst,
    }
    return partial(_readable, readers[kind])


def _readable(read: Reader, data: bytes) -> tuple[float, str]:
    try:
        return read(data)
    except Exception:  # noqa: BLE001 - the bytes may be anything
        return nan, ""


def _bool(data: bytes) -> tuple[float, str]:
    (value,) = CdrReader(data).take("B")
    if value > 1:
        raise struct.error(f"{value} is no bool")
    return float(value), ""


def _button(number: int, data: bytes) -> tuple[float, str]:
    """Return 1 if button `number` is pressed, else 0. Without such a button, raise IndexError."""
    message = CdrReader(data)
    message.skip_header()
    message.take("f", *message.take("I"))
    return float(message.take("i", *message.take("I"))[number] != 0), ""


def _tilt(data: bytes) -> tuple[float, str]:
    """Return the angle between the upward axes of robot and world (REP-103), rounded to 0.01 rad.

    Return NaN if the quaternion is not of length 1, or the covariance begins with -1.
    """
    message = CdrReader(data)
    message.skip_header()
    x, y, z, w, covariance = message.take("d", 5)
    length = (x**2 + y**2 + z**2 + w**2) ** 0.5
    if covariance == -1.0 or not abs(length - 1.0) <= UNIT_TOLERANCE:
        return nan, ""
    upward = 1.0 - 2.0 * (x**2 + y**2) / length**2
    return round(acos(max(-1.0, min(1.0, upward))), 2), ""


def statuses(robot: str, data: bytes) -> Iterator[tuple[str, float, str]]:
    """Yield name, level and "name: text" of each DiagnosticStatus except those sent by `robot`.

    Raises:
        struct.error: The message is cut short, not in plain CDR, or too long.
    """
    message = CdrReader(data)
    message.skip_header()
    values = 0
    for _ in range(_count(message, MAX_STATUSES)):
        (level,) = message.take("B")
        name, text, hardware_id = message.text(), message.text(), message.text()
        count = _count(message, MAX_VALUES - values)
        values += count
        for _ in range(2 * count):
            message.octets(*message.take("I"))
        if hardware_id != robot or not name.startswith(f"{robot}: "):
            yield name, float(level), short_name(f"{name}: {text}")


def _count(message: CdrReader, most: int) -> int:
    (count,) = message.take("I")
    if count > most:
        raise struct.error(f"{count} diagnoses or values, more than {most}")
    return int(count)


class Diagnoses:
    """The last level of each DiagnosticStatus by name, without robotctl's own for `robot`."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._levels: dict[str, tuple[float, str]] = {}

    def worst(self, data: bytes) -> tuple[float, str]:
        """Store the levels of a DiagnosticArray; return the worst stored one, with name and text.

        Raises:
            struct.error: The message is unreadable; the levels stay as they were.
        """
        for name, level, text in [*statuses(self._robot, data)]:
            levels = self._levels
            if name not in levels and len(levels) >= MAX_DIAGNOSES:
                del levels[min(levels, key=lambda each: levels[each][0])]
            levels[name] = level, text
        return max(self._levels.values(), default=(0.0, ""), key=lambda each: each[0])
