"""The simulated robot on ROS. It receives commands, and publishes odometry and battery."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import nan

from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import BatteryState

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.geometry import Pose
from robotctl.kernel.types import ZERO
from robotctl.messages.inputs import OdometryEncoder
from robotctl.ros import qos
from robotctl.ros.executor import RawTap, Tick, Ticker
from robotctl.ros.message_types import PLAIN, CommandType, OwnTopic, subscribe_raw
from robotctl.ros.session import Session
from robotctl.sim import Robot, SimFault, SimParams


def battery_message(level: float, stamp_ns: int) -> BatteryState:
    """Return a BatteryState with `level` as its percentage, and NaN for all other values."""
    message = BatteryState()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS_PER_S)
    message.percentage = level
    message.voltage = message.current = message.charge = nan
    message.capacity = message.design_capacity = message.temperature = nan
    message.present = True
    message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message


MAX_STEP_S = 0.1
"""The longest step of the motion, so that the robot does not jump after a pause."""

# So short that one wake-up of the loop handles both timers, the robot's first.
LEAD_NS = 5_000
"""The time by which the simulated robot moves before each control tick, for fresh odometry."""


def odometry_topic(name: str) -> OwnTopic:
    """Return the topic `name` for the odometry of the simulated robot."""
    return OwnTopic(name, OdometryMessage, qos.SENSOR)


def battery_topic(name: str) -> OwnTopic:
    """Return the topic `name` for the battery level of the simulated robot."""
    return OwnTopic(name, BatteryState, qos.SENSOR)


class SimulatedRobot:
    """Node `simulated_robot`. The robot moves while `run` runs."""

    def __init__(
        self,
        session: Session,
        params: SimParams,
        *,
        command: str,
        command_type: CommandType = PLAIN,
        odometry: str,
        battery: str,
        full_level: float,
    ) -> None:
        """Create the node. `command`, `odometry` and `battery` are the names of its topics.

        If `battery` is "", no battery level is published. `full_level` is the published level of a
        full battery.
        """
        self._params = params
        self._robot = Robot(params)
        self._decode = command_type.decode
        self._full_level = full_level
        self._is_changed = False
        self._moved_ns = 0
        self._battery_due_ns = 0
        self._wall_ns = 0
        """Wall-clock time minus steady time [ns] at the start of `run`."""

        node = session.node("simulated_robot")
        tap = RawTap(self._command, latency_s=None)
        self._subscription = subscribe_raw(
            node, command_type.message_class, command, tap, command_type.qos
        )
        self._take_command: Callable[[], None] = lambda: tap.poll()
        self._encoder = OdometryEncoder("odom", "base_link")
        self._odometry = odometry_topic(odometry).create_publisher(node)
        self._battery = battery_topic(battery).create_publisher(node) if battery else None

    async def run(self) -> None:
        """Move the robot and publish odometry until cancelled, and the battery level at 1 Hz."""
        self._moved_ns = self._battery_due_ns = time.monotonic_ns()
        # Read only once: if the wall clock is set back later, the stamps must still increase.
        self._wall_ns = time.time_ns() - self._moved_ns
        await Ticker(self._params.odometry_rate_hz, lead_ns=LEAD_NS).run(self._move)

    def _move(self, tick: Tick) -> None:
        self._take_command()
        robot = self._robot
        robot.advance(min((tick.t_ns - self._moved_ns) / NS_PER_S, MAX_STEP_S))
        self._moved_ns = tick.t_ns
        stamp_ns = self._wall_ns + tick.t_ns
        faults = robot.faults
        if SimFault.HANG in faults:
            return
        if SimFault.ODOM_LOST not in faults:
            pose = faults.reported_pose(robot.odometry)
            self._odometry.publish(self._encoder.encode(pose, robot.measured, stamp_ns))
        is_due = tick.t_ns >= self._battery_due_ns
        if self._battery is not None and (is_due or self._is_changed):
            if is_due:
                self._battery_due_ns += NS_PER_S
            self._is_changed = False
            level = self._full_level * faults.reported_level(robot.battery)
            self._battery.publish(battery_message(level, stamp_ns))

    def truth(self) -> Pose:
        """Return the true pose of the robot."""
        return self._robot.truth

    def set_battery(self, level: float) -> None:
        """Set the battery level, 0 to 1. The next step of the motion publishes it."""
        self._robot.battery = level
        self._is_changed = True

    def begin_fault(self, fault: SimFault, for_s: float) -> None:
        """Begin `fault` for `for_s` seconds of simulated time."""
        self._robot.faults.begin(fault, for_s)
        self._is_changed = True

    def _command(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        try:
            twist = self._decode(data)
        except Exception:  # noqa: BLE001 - no received bytes may stop the robot
            twist = ZERO
        self._robot.command(twist)
