"""Receives the safety inputs: buttons, bumper, tilt, and the diagnostics of the robot's base."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isnan, nan
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Imu, Joy
from std_msgs.msg import Bool

from robotctl.cdr.safety_inputs import Reader, reader_of
from robotctl.kernel.safety_inputs import (
    REPEATS_PER_TIMEOUT,
    SafetyInput,
    SafetyInputParams,
    Use,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.ros.executor import RawTap
from robotctl.ros.messages import qos
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.session import Session

OnReading = Callable[[SafetyInput, float, str, str, int], None]
"""Called with an input, its value and its text as a `Reader` returns them, the gid of the publisher
in hexadecimal digits, and the publisher's own number of the message.
"""

_CLASSES: dict[SafetyInput, Any] = {
    SafetyInput.ESTOP: Bool,
    SafetyInput.JOY: Joy,
    SafetyInput.BUMPER: Bool,
    SafetyInput.TILT: Imu,
    SafetyInput.DIAGNOSTICS: DiagnosticArray,
}


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
        used = [kind for kind in SafetyInput if params.of(kind).use is not Use.OFF]
        if not used:
            return
        node = session.helper()
        for kind in used:
            read = reader_of(kind, button=params.joy.button, robot=robot)
            repeat_ns = round(params.of(kind).timeout_s * NS_PER_S / REPEATS_PER_TIMEOUT)
            tap: Any = RawTap(partial(self._receive, kind, read, repeat_ns, _Last()), latency_s=0.0)
            node.create_subscription(
                _CLASSES[kind],
                params.of(kind).topic,
                tap,
                qos.SENSOR,
                event_callbacks=NO_SUBSCRIPTION_EVENTS,
                raw=True,
            )

    def _receive(
        self,
        kind: SafetyInput,
        read: Reader,
        repeat_ns: int,
        last: _Last,
        data: bytes,
        received_ns: int,
        source_ns: int,
        sequence: int,
        gid: bytes,
    ) -> None:
        value, detail = read(data)
        now_ns = time.monotonic_ns()
        is_equal = value == last.value or (isnan(value) and isnan(last.value))
        if not is_equal or now_ns - last.t_ns >= repeat_ns:
            last.value, last.t_ns = value, now_ns
            self._on_reading(kind, value, detail, gid.hex(), sequence)
