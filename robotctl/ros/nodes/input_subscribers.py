"""Subscribers of battery, scans, safety inputs and the velocities that another node requests."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from math import isnan, nan
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.subscription import Subscription
from sensor_msgs.msg import BatteryState, Imu, Joy, LaserScan
from std_msgs.msg import Bool

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.safety_inputs import REPEATS_PER_TIMEOUT, SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import Twist
from robotctl.messages.inputs import read_battery_level, read_sectors, reader_of
from robotctl.ros import qos
from robotctl.ros.executor import RawTap
from robotctl.ros.message_types import CommandType, subscribe_raw
from robotctl.ros.session import Session

T = TypeVar("T")


def report_values(
    session: Session,
    message_class: Any,
    topic: str,
    read: Callable[[bytes], T],
    on_value: Callable[[T, str, int], None],
) -> Subscription:
    """Subscribe on node `_recorder`, and call `on_value(value, publisher, sequence)` per message.

    `read` returns the value of a serialized message, and must not raise. `publisher` is the
    publisher's gid in hex, and `sequence` the message's sequence number.
    """

    def receive(data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes) -> None:
        on_value(read(data), gid.hex(), sequence)

    tap = RawTap(receive, latency_s=0.0)
    return subscribe_raw(session.helper(), message_class, topic, tap, qos.SENSOR)


def report_battery(
    session: Session, topic: str, on_level: Callable[[float, str, int], None]
) -> Subscription:
    """Call `on_level(level, publisher, sequence)` for each battery message; NaN if unreadable."""
    return report_values(session, BatteryState, topic, read_battery_level, on_level)


def report_scans(
    session: Session, topic: str, on_scan: Callable[[tuple[float, ...], str, int], None]
) -> Subscription:
    """Call `on_scan` for each scan with the nearest range [m] per sector, () if it is malformed."""
    return report_values(session, LaserScan, topic, read_sectors, on_scan)


def report_wanted_commands(
    session: Session,
    topic: str,
    command: CommandType,
    on_command: Callable[[Twist, str, int], None],
) -> Subscription:
    """Call `on_command` for each velocity requested on `topic`, NaN if it is unreadable."""

    def read(data: bytes) -> Twist:
        try:
            return command.decode(data)
        except struct.error:
            return Twist(nan, nan)

    return report_values(session, command.message_class, topic, read, on_command)


OnReading = Callable[[SafetyInput, float, str, str, int], None]
"""Called with an input, its value and text (as `messages.inputs.reader_of` reads them), the
publisher's gid in hex and its sequence number.
"""

_CLASSES: dict[SafetyInput, Any] = {
    SafetyInput.ESTOP: Bool,
    SafetyInput.JOY: Joy,
    SafetyInput.BUMPER: Bool,
    SafetyInput.TILT: Imu,
    SafetyInput.DIAGNOSTICS: DiagnosticArray,
}


def report_safety_inputs(
    session: Session, params: SafetyInputParams, robot: str, on_reading: OnReading
) -> None:
    """Subscribe on node `_recorder` to each safety input in use.

    `on_reading` is called for each changed value, and for an unchanged one at most
    REPEATS_PER_TIMEOUT times per timeout of the input.
    """
    for kind in SafetyInput:
        if params.of(kind).use is not Use.OFF:
            _report_safety_input(session, params, kind, robot, on_reading)


def _report_safety_input(
    session: Session,
    params: SafetyInputParams,
    kind: SafetyInput,
    robot: str,
    on_reading: OnReading,
) -> None:
    repeat_ns = round(params.of(kind).timeout_s * NS_PER_S / REPEATS_PER_TIMEOUT)
    last_value, last_ns = nan, 0

    def report(reading: tuple[float, str], publisher: str, sequence: int) -> None:
        nonlocal last_value, last_ns
        (value, detail), now_ns = reading, time.monotonic_ns()
        is_equal = value == last_value or (isnan(value) and isnan(last_value))
        if not is_equal or now_ns - last_ns >= repeat_ns:
            last_value, last_ns = value, now_ns
            on_reading(kind, value, detail, publisher, sequence)

    read = reader_of(kind, button=params.joy.button, robot=robot)
    report_values(session, _CLASSES[kind], params.of(kind).topic, read, report)
