"""A second process on the graph: it drives and stops the robot, and receives its commands."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from geometry_msgs.msg import Twist
from rclpy.node import Node
from rclpy.qos import QoSProfile
from robot_controller.srv import SetMode
from std_srvs.srv import Trigger

from robotctl.base.errors import RobotctlError
from robotctl.ipc.client import call
from robotctl.kernel.modes import Mode
from tests.support.waiting import until

PATIENCE_S = 5.0
"""A stop that takes longer than this [s] counts as never."""

ONWARD_MPS = 0.2
"""A robot this fast needs 0.2 s to a standstill, so that its ramp does not count as the stop."""

ANSWERS = QoSProfile(depth=10_000)
"""Every client's queue gets the answers to all clients: under a flood, a depth of 10 is too low."""

RAMP_S = 0.01
"""The time from a request for IDLE to the stop that comes while that request waits [s]."""

SOURCE = "benchmarks/estop.py"


class Witness:
    """A node of plain rclpy; the time of a command is that at which Fast DDS received it."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._set_mode = node.create_client(SetMode, "/set_mode", qos_profile=ANSWERS)
        self._estop = node.create_client(Trigger, "/estop", qos_profile=ANSWERS)
        self._lock = threading.Lock()
        self._asked_ns = 0
        self._zero_ns = 0
        self._speed = 0.0
        # rclpy's own types know a callback of one argument only.
        take: Any = self._take
        node.create_subscription(Twist, "/cmd_vel", take, 1000)
        until(self._set_mode.service_is_ready)
        self.ways: dict[str, Callable[[], None]] = {
            "control socket": self._by_socket,
            "service set_mode": self._by_set_mode,
        }
        if self._estop.wait_for_service(2.0):
            self.ways["service estop"] = self._by_estop

    def measure(self, way: str, after_s: float, *, ramping: bool) -> float:
        """Drive, stop after `after_s` at speed, reset; return the time to the first zero [ms].

        The time is infinite without a zero. With `ramping`, the stop comes while a request for IDLE
        waits for the end of its ramp.
        """
        self._request(Mode.MOVING)
        until(lambda: abs(self._speed) > ONWARD_MPS)
        time.sleep(after_s)
        if ramping:
            self._ask(Mode.IDLE)
            time.sleep(RAMP_S)
        with self._lock:
            self._zero_ns, self._asked_ns = 0, time.time_ns()
        with suppress(RobotctlError, TimeoutError):  # what counts is whether the robot stops
            self.ways[way]()
        end = time.monotonic() + PATIENCE_S
        while not self._zero_ns and time.monotonic() < end:
            time.sleep(0.001)
        taken_ms = (self._zero_ns - self._asked_ns) / 1e6 if self._zero_ns else math.inf
        self._asked_ns = 0
        self._request(Mode.IDLE)
        return taken_ms

    def _take(self, command: Any, info: Any) -> None:
        parts = (command.linear, command.angular)
        is_zero = not any(axis for each in parts for axis in (each.x, each.y, each.z))
        self._speed = command.linear.x
        with self._lock:
            at_ns = info["received_timestamp"]
            if is_zero and 0 < self._asked_ns <= at_ns and not self._zero_ns:
                self._zero_ns = at_ns

    def _request(self, mode: Mode) -> None:
        """Request `mode` until the robot is in it: a request may be refused, or lost in a flood."""
        until(lambda: self._reaches(mode))

    def _reaches(self, mode: Mode) -> bool:
        try:
            return bool(self._wait(self._ask(mode)).current_mode == mode.value)
        except TimeoutError:
            return False

    def _ask(self, mode: Mode) -> Any:
        return self._set_mode.call_async(SetMode.Request(requested_mode=mode.value))

    def _by_socket(self) -> None:
        stop = {"mode": Mode.EMERGENCY_STOP.value, "source": SOURCE}
        call("robot", "set_mode", stop)

    def _by_set_mode(self) -> None:
        self._wait(self._ask(Mode.EMERGENCY_STOP))

    def _by_estop(self) -> None:
        self._wait(self._estop.call_async(Trigger.Request()))

    def _wait(self, future: Any) -> Any:
        end = time.monotonic() + PATIENCE_S
        while not future.done():
            if time.monotonic() > end:
                raise TimeoutError
            time.sleep(0.0005)
        return future.result()
