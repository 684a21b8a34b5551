"""Reads a robot's inputs from messages: battery, scan, buttons, gamepad, bumper, tilt, diagnoses.

A reader gets a serialized message and returns two values: the number that `SafetyInput` defines,
NaN if the message is unreadable, and the sender's text or "".
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import partial
from math import acos, inf, isfinite, nan, pi, tau

from robotctl.base.text import short_name
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.messages.cdr import CdrReader

_PERCENTAGE = 6
"""The index of the level among the float32 fields that follow the header."""


def read_battery_level(data: bytes) -> float:
    """Return the level of a serialized BatteryState as its publisher reports it, NaN if unreadable.

    REP-147 and the message require 0..1; other scales are configured by `battery.scale`.
    """
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
        struct.error: The message is cut short, not in plain CDR, or has no sensible angles.
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

MESSAGE_TYPES = {
    SafetyInput.ESTOP: "std_msgs/msg/Bool",
    SafetyInput.JOY: "sensor_msgs/msg/Joy",
    SafetyInput.BUMPER: "std_msgs/msg/Bool",
    SafetyInput.TILT: "sensor_msgs/msg/Imu",
    SafetyInput.DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}

MAX_DIAGNOSES = 256
"""Limit on the diagnoses that are kept; beyond it the least severe one is forgotten."""

MAX_STATUSES = 2_000
"""Limit on the diagnoses in one message; a message with more is unreadable."""

MAX_VALUES = 20_000
"""Limit on the key-value pairs in one message: reading this many takes about 20 ms."""

UNIT_TOLERANCE = 0.1
"""How far the length of a quaternion may be from 1."""


def reader_of(kind: SafetyInput, *, button: int, robot: str) -> Reader:
    """Return the reader of an input.

    That of JOY reads the button with the number `button`; that of DIAGNOSTICS ignores the diagnoses
    that `robot` itself sends.
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

    Return NaN if the quaternion is not of length 1, or if the covariance begins with -1, which
    means that there is no orientation (sensor_msgs/Imu).
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
    """Yield name, level and `name: text` of each diagnosis that `robot` did not send itself.

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
    """The last level of each diagnosis that robotctl did not send itself."""

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
