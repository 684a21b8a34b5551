"""A kernel with serialized, numbered messages as inputs, as in a daemon."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import replace
from math import cos, isnan, pi, sin, tau

from robotctl.config import Config
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.kernel.types import (
    BatteryReceived,
    Effect,
    Event,
    GuardedCommandReceived,
    OdomReceived,
    SafetyInputReceived,
    ScanReceived,
)
from robotctl.messages.cdr import ENCAPSULATION
from robotctl.messages.inputs import (
    OdometryEncoder,
    encode_twist,
    read_battery_level,
    read_odometry,
    read_sectors,
)

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
    """Return the serialized message of the safety input `kind` with `value`, or b"" for NaN.

    For DIAGNOSTICS, `value` is the level, and `detail` the name and message as NAME: TEXT.
    """
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


ODOMETRY, BATTERY, SCAN, WANTED = "/odom", "/battery_state", "/scan", "/cmd_vel_nav"

_BATTERY = struct.Struct("<4siII1s3x7f")
"""A BatteryState with an empty frame name, up to the level."""


_SCAN = struct.Struct("<4siII1s3x7fI64fI")
"""A LaserScan of 64 rays with an empty frame name."""


def _scan(sectors: tuple[float, ...]) -> bytes:
    """Return a LaserScan with a ray in the middle of each sector."""
    step = tau / len(sectors)
    head = (-pi + step / 2.0, pi, step, 0.0, 0.0, 0.05, 100.0)
    return _SCAN.pack(ENCAPSULATION, 0, 0, 1, b"\0", *head, len(sectors), *sectors, 0)


class HearingKernel(Kernel):
    """A kernel whose inputs pass through serialized ROS messages, as in a daemon.

    `heard` is the last event. `messages` maps (topic, sequence number) to a serialized message.
    """

    def __init__(self, config: Config) -> None:
        """Begin in IDLE, with the parameters of the configuration."""
        super().__init__(config.kernel)
        self.heard: Event | None = None
        self.messages: dict[tuple[str, int], bytes] = {}
        self._odometry_encoder = OdometryEncoder("odom", "base_link")
        self._counts = Counter[str]()

    def step(self, event: Event) -> tuple[Effect, ...]:
        """Return the effects of `event`, after an input was serialized, numbered and read back."""
        if isinstance(event, OdomReceived):
            sample = event.odometry
            data = self._odometry_encoder.encode(sample.pose, sample.velocity, sample.stamp_ns)
            number = self._keep(ODOMETRY, data)
            event = replace(event, odometry=read_odometry(data), source=1, sequence=number)
        elif isinstance(event, BatteryReceived):
            data = _BATTERY.pack(ENCAPSULATION, 0, 0, 1, b"\0", *[0.0] * 6, event.level)
            level = read_battery_level(data)
            event = BatteryReceived(event.t_ns, level, "ba77e7", self._keep(BATTERY, data))
        elif isinstance(event, ScanReceived):
            data = _scan(event.sectors)
            event = ScanReceived(event.t_ns, read_sectors(data), "5ca7", self._keep(SCAN, data))
        elif isinstance(event, GuardedCommandReceived):
            number = self._keep(WANTED, encode_twist(event.twist))
            event = replace(event, publisher="9a7d", sequence=number)
        elif isinstance(event, SafetyInputReceived):
            data = safety_message(event.kind, event.value, event.detail)
            event = replace(event, publisher="5afe", sequence=self._keep(TOPICS[event.kind], data))
        self.heard = event
        return super().step(event)

    def _keep(self, topic: str, data: bytes) -> int:
        """Keep a message, and return its number in its topic."""
        self._counts[topic] += 1
        self.messages[topic, self._counts[topic]] = data
        return self._counts[topic]
