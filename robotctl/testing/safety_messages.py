"""Serialized messages of safety inputs, made without ROS."""

from __future__ import annotations

import struct
from math import cos, isnan, sin

from robotctl.cdr.reader import ENCAPSULATION
from robotctl.kernel.safety_inputs import SafetyInput

TOPICS = {
    SafetyInput.ESTOP: "/estop_pressed",
    SafetyInput.JOY: "/joy",
    SafetyInput.BUMPER: "/bumper",
    SafetyInput.TILT: "/imu",
    SafetyInput.DIAGNOSTICS: "/diagnostics",
}
"""The default topics, for a robot without a namespace."""

_HEADER = struct.pack("<4siII1s3x", ENCAPSULATION, 0, 0, 1, b"\0")
"""A header with an empty frame name."""


def safety_message(kind: SafetyInput, value: float, detail: str = "") -> bytes:
    """Return a message that says `value`; `detail` is "NAME: TEXT" of a diagnosis, or ""."""
    if isnan(value):
        return b""
    if kind is SafetyInput.JOY:
        return _HEADER + struct.pack("<III", 0, 1, int(value))
    if kind is SafetyInput.TILT:
        orientation = (sin(value / 2.0), 0.0, 0.0, cos(value / 2.0))
        return _HEADER + struct.pack("<4d33d", *orientation, *[0.0] * 33)
    if kind is SafetyInput.DIAGNOSTICS:
        return _HEADER + (_diagnosis(int(value), *detail.split(": ", 1)) if detail else bytes(4))
    return ENCAPSULATION + bytes([int(value)])


def _diagnosis(level: int, name: str, text: str) -> bytes:
    data = struct.pack("<IB3x", 1, level)
    for each in (name, text, "base"):
        data += struct.pack("<I", len(each) + 1) + each.encode() + b"\0"
        data += bytes(-len(data) % 4)
    return data + bytes(4)
