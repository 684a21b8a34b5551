"""Receives the safety inputs: buttons, bumper, tilt, and the diagnostics of the robot's base."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import acos, isnan, nan
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, Joy
from std_msgs.msg import Bool

from robotctl.kernel.safety_inputs import SafetyInput, SafetyInputParams, Use
from robotctl.kernel.units import NS_PER_S
from robotctl.printable import short_name
from robotctl.ros.messages import qos
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session

REPEATS_PER_TIMEOUT = 4
"""Equal values are handed on so often, which shows that the input is heard."""

MAX_DIAGNOSES = 256
"""Limit on the diagnoses that are kept; beyond it the least severe one is forgotten."""

UNIT_TOLERANCE = 0.1
"""How far the length of a quaternion may be from 1."""

OnReading = Callable[[SafetyInput, float, str], None]
"""Called with an input, its value as `SafetyInput` says, NaN if unreadable, and a text or ""."""


@dataclass(slots=True)
class _Last:
    """The last value that was handed on, and when [steady ns]."""

    value: float = nan
    t_ns: int = 0


class SafetyInputs:
    """A part of the hidden node; receives the inputs that are used, from publishers of any QoS."""

    def __init__(
        self, session: Session, params: SafetyInputParams, robot: str, on_reading: OnReading
    ) -> None:
        """Call `on_reading` for each new value, and for equal ones often enough."""
        self._on_reading = on_reading
        diagnoses = Diagnoses(robot)
        readers: dict[SafetyInput, tuple[Any, Callable[[Any], tuple[float, str]]]] = {
            SafetyInput.ESTOP: (Bool, _bool),
            SafetyInput.JOY: (Joy, partial(_button, params.joy.button)),
            SafetyInput.BUMPER: (Bool, _bool),
            SafetyInput.TILT: (Imu, _tilt),
            SafetyInput.DIAGNOSTICS: (DiagnosticArray, diagnoses.worst),
        }
        used = [kind for kind in SafetyInput if params.of(kind).use is not Use.OFF]
        if not used:
            return
        node = session.helper()
        for kind in used:
            message_class, read = readers[kind]
            repeat_ns = round(params.of(kind).timeout_s * NS_PER_S / REPEATS_PER_TIMEOUT)
            node.create_subscription(
                message_class,
                params.of(kind).topic,
                partial(self._receive, kind, message_class, read, repeat_ns, _Last()),
                qos.SENSOR,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
                raw=True,
            )

    def _receive(
        self,
        kind: SafetyInput,
        message_class: Any,
        read: Callable[[Any], tuple[float, str]],
        repeat_ns: int,
        last: _Last,
        data: bytes,
    ) -> None:
        try:
            value, detail = read(deserialize_message(data, message_class))
        except Exception:  # noqa: BLE001 - no received bytes may stop the daemon
            value, detail = nan, ""
        now_ns = time.monotonic_ns()
        is_equal = value == last.value or (isnan(value) and isnan(last.value))
        if not is_equal or now_ns - last.t_ns >= repeat_ns:
            last.value, last.t_ns = value, now_ns
            self._on_reading(kind, value, detail)


def _bool(message: Any) -> tuple[float, str]:
    return float(message.data), ""


def _button(number: int, message: Any) -> tuple[float, str]:
    """Return whether the button is pressed; a gamepad without it is unreadable."""
    return float(message.buttons[number] != 0), ""


def _tilt(message: Any) -> tuple[float, str]:
    """Return the angle between the upward axes of robot and world (REP-103), rounded to 0.01 rad.

    A covariance that begins with -1 says that there is no orientation (sensor_msgs/Imu).
    """
    q = message.orientation
    length = (q.x**2 + q.y**2 + q.z**2 + q.w**2) ** 0.5
    if message.orientation_covariance[0] == -1.0 or not abs(length - 1.0) <= UNIT_TOLERANCE:
        return nan, ""
    upward = 1.0 - 2.0 * (q.x**2 + q.y**2) / length**2
    return round(acos(max(-1.0, min(1.0, upward))), 2), ""


class Diagnoses:
    """The last level of each diagnosis that robotctl did not send itself."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._levels: dict[str, tuple[float, str]] = {}

    def worst(self, message: Any) -> tuple[float, str]:
        """Take a DiagnosticArray; return the worst level of all, and its name and text."""
        for status in message.status:
            if status.hardware_id == self._robot and status.name.startswith(f"{self._robot}: "):
                continue
            levels = self._levels
            if status.name not in levels and len(levels) >= MAX_DIAGNOSES:
                del levels[min(levels, key=lambda name: levels[name][0])]
            text = short_name(f"{status.name}: {status.message}")
            levels[status.name] = float(ord(status.level)), text
        return max(self._levels.values(), default=(0.0, ""), key=lambda each: each[0])
