"""Subscribers of battery, scans, safety inputs and the velocities that another node wants."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isnan, nan
from typing import Any, Generic, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import BatteryState, Imu, Joy, LaserScan
from std_msgs.msg import Bool

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.safety_inputs import REPEATS_PER_TIMEOUT, SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import Twist
from robotctl.messages.inputs import Reader, read_battery_level, read_sectors, reader_of
from robotctl.ros import qos
from robotctl.ros.executor import RawTap
from robotctl.ros.message_types import NO_SUBSCRIPTION_EVENTS, CommandType
from robotctl.ros.session import Session

T = TypeVar("T")


class NumberedSubscriber(Generic[T]):
    """Subscribes on node `_recorder` to publishers of any QoS; reports each message's value."""

    def __init__(
        self,
        session: Session,
        message_class: Any,
        topic: str,
        read: Callable[[bytes], T],
        on_value: Callable[[T, str, int], None],
    ) -> None:
        """Call `on_value(value, publisher, sequence)` for each message.

        `read` returns the value of a serialized message, and must not raise. `publisher` is the
        publisher's gid in hex, `sequence` the publisher's sequence number of the message.
        """
        self._read = read
        self._on_value = on_value
        tap: Any = RawTap(self._receive, latency_s=0.0)
        self._subscription = session.helper().create_subscription(
            message_class,
            topic,
            tap,
            qos.SENSOR,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )

    def _receive(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        self._on_value(self._read(data), gid.hex(), sequence)


class BatterySubscriber(NumberedSubscriber[float]):
    """Reports the battery level of each message, NaN for an unreadable message."""

    def __init__(
        self, session: Session, topic: str, on_level: Callable[[float, str, int], None]
    ) -> None:
        """Call `on_level(level, publisher, sequence)`."""
        super().__init__(session, BatteryState, topic, read_battery_level, on_level)


class ScanSubscriber(NumberedSubscriber[tuple[float, ...]]):
    """Reports the nearest range in each sector of each scan, () for an unreadable scan."""

    def __init__(
        self, session: Session, topic: str, on_scan: Callable[[tuple[float, ...], str, int], None]
    ) -> None:
        """Call `on_scan(sectors, publisher, sequence)`."""
        super().__init__(session, LaserScan, topic, read_sectors, on_scan)


class GuardSubscriber(NumberedSubscriber[Twist]):
    """Reports each velocity that a node wants, from `guard_topic`; NaN: an unreadable message."""

    def __init__(
        self,
        session: Session,
        topic: str,
        command: CommandType,
        on_command: Callable[[Twist, str, int], None],
    ) -> None:
        """Call `on_command(twist, publisher, sequence)` for each message of the type `command`."""

        def read(data: bytes) -> Twist:
            try:
                return command.decode(data)
            except struct.error:
                return Twist(nan, nan)

        super().__init__(session, command.message_class, topic, read, on_command)


OnReading = Callable[[SafetyInput, float, str, str, int], None]
"""Called with an input, the value and the text that its `Reader` returned, the publisher's gid in
hex, and the publisher's sequence number of the message."""

_CLASSES: dict[SafetyInput, Any] = {
    SafetyInput.ESTOP: Bool,
    SafetyInput.JOY: Joy,
    SafetyInput.BUMPER: Bool,
    SafetyInput.TILT: Imu,
    SafetyInput.DIAGNOSTICS: DiagnosticArray,
}


@dataclass(slots=True)
class _Last:
    """The last value that was reported, and the time of the report [steady ns]."""

    value: float = nan
    t_ns: int = 0


class SafetyInputs:
    """Subscribes on node `_recorder` to each safety input in use, and reports its values."""

    def __init__(
        self, session: Session, params: SafetyInputParams, robot: str, on_reading: OnReading
    ) -> None:
        """Call `on_reading` for each changed value, and REPEATS_PER_TIMEOUT times per timeout
        for an unchanged one."""
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
