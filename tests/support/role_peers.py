"""Peers of plain rclpy with one role each; each peer runs in a separate process."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Twist, TwistStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import Log, LoggerLevel, ParameterEvent
from rcl_interfaces.srv import GetLoggerLevels, SetLoggerLevels
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    qos_profile_sensor_data,
    qos_profile_system_default,
)
from robot_controller.action import DrivePattern
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from tests.support.ros_peer import NodePeer, fields, run_peer
from tests.support.waiting import DEADLINE_S, until

GOALS = QoSProfile(depth=1_500)
"""The depth for the answers to a flood of goals; the default of rclpy is 10."""

STATUS = {
    getattr(GoalStatus, f"STATUS_{name}"): name
    for name in ("UNKNOWN", "ACCEPTED", "EXECUTING", "SUCCEEDED", "CANCELED", "ABORTED")
}


class ActionPeer(NodePeer):
    """A client of the action `drive_pattern`."""

    def __init__(self) -> None:
        self.node = Node("action_client")
        self.client = ActionClient(
            self.node, DrivePattern, "drive_pattern", goal_service_qos_profile=GOALS
        )
        self.sent: list[Any] = []
        self.feedback: list[list[tuple[float, int, float]]] = []
        self.flood: list[Any] = []

    def send(self, **goal: Any) -> int:
        """Send a goal and wait until it is accepted; return its number, -1 if it is rejected."""
        assert self.client.wait_for_server(DEADLINE_S), "no such action"
        feedback: list[tuple[float, int, float]] = []

        def keep(message: Any) -> None:
            told = message.feedback
            feedback.append((told.distance, told.lap, told.cross_track_error))

        handle = self._answer(
            lambda: self.client.send_goal_async(_goal(goal), feedback_callback=keep)
        )
        if not handle.accepted:
            return -1
        self.sent.append(handle)
        self.feedback.append(feedback)
        return len(self.sent) - 1

    def heard(self, number: int) -> list[tuple[float, int, float]]:
        """Return the feedback of a goal: distance, lap, cross-track error."""
        return list(self.feedback[number])

    def cancel(self, number: int) -> int:
        """Request to cancel a goal; return the number of goals that are cancelled."""
        return len(self._answer(self.sent[number].cancel_goal_async).goals_canceling)

    def result(self, number: int) -> dict[str, Any]:
        """Wait for the result of a goal; return its status and fields."""
        response = self._answer(self.sent[number].get_result_async)
        return {"status": STATUS[response.status], **fields(response.result)}

    def end(self) -> None:
        self.client.destroy()

    def begin_flood(self, count: int) -> None:
        """Send `count` goals without waiting for answers."""
        assert self.client.wait_for_server(DEADLINE_S), "no such action"
        self.flood = self._in_executor(
            lambda: [self.client.send_goal_async(_goal({})) for _ in range(count)]
        )

    def end_flood(self) -> dict[str, int]:
        """Wait until all goals of the flood are answered; return how many and how."""
        until(lambda: all(each.done() for each in self.flood))
        answers = [each.result().accepted for each in self.flood]
        return {"answered": len(answers), "accepted": sum(answers)}

    def _answer(self, ask: Callable[[], Any]) -> Any:
        future = self._in_executor(ask)
        until(future.done)
        return future.result()

    def _in_executor(self, ask: Callable[[], Any]) -> Any:
        """Call `ask` in the thread of the executor, and return its result.

        rclpy registers a request after sending it: elsewhere an answer between both is lost.
        """
        executor = self.node.executor
        assert executor is not None
        asked = executor.create_task(ask)
        until(asked.done)
        return asked.result()


def _goal(values: dict[str, Any]) -> Any:
    return DrivePattern.Goal(**{name: _number(value) for name, value in values.items()})


def _number(value: Any) -> Any:
    """Return a float for "nan" and "inf", which JSON has no numbers for, else the value."""
    return float(value) if value in ("nan", "inf") else value


class LifecyclePeer(NodePeer):
    """A manager of the node `mode_service`."""

    def __init__(self) -> None:
        self.node = Node("manager")

    def state(self) -> str:
        """Return the label of the present state."""
        return str(
            self._ask(GetState, "/mode_service/get_state", GetState.Request()).current_state.label
        )

    def change(self, label: str = "", id: int = 0) -> bool:  # noqa: A002 - as in the message
        """Request a transition; return whether it happened."""
        request = ChangeState.Request(transition=Transition(id=id, label=label))
        return bool(self._ask(ChangeState, "/mode_service/change_state", request).success)

    def zeros(self) -> int:
        """Wait for three commands; return how many came, -1 if any is not zero."""
        heard: list[float] = []

        def hear(message: Any) -> None:
            heard.append(message.linear.x)

        subscription = self.node.create_subscription(Twist, "/cmd_vel", hear, 10)
        until(lambda: len(heard) >= 3)
        self.node.destroy_subscription(subscription)
        return -1 if any(heard) else len(heard)


LATCHED_LOCK = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PERIOD_S = 0.02


class MuxPeer(NodePeer):
    """A planner, and a stand-in for twist_mux: it passes a velocity on while its lock is open."""

    def __init__(self) -> None:
        self.node = Node("planner")
        self.locked: bool | None = None
        self.passed = 0
        self._planning: Any = None

    def want(self, topic: str, linear: float) -> None:
        """Publish a velocity on a topic every 20 ms, as a planner does, until `rest`."""
        publisher = self.node.create_publisher(Twist, topic, 10)
        message = Twist()
        message.linear.x = linear
        self._planning = self.node.create_timer(PERIOD_S, lambda: publisher.publish(message))

    def rest(self) -> None:
        """Publish no more velocities."""
        self.node.destroy_timer(self._planning)

    def mux(self, lock: str, wanted: str) -> None:
        """Subscribe to a latched Bool as the lock, and to the velocities that it lets pass."""
        # rclpy's types allow callbacks of one argument only.
        take_lock: Any = self._take_lock
        take: Any = self._take
        self.node.create_subscription(Bool, lock, take_lock, LATCHED_LOCK)
        self.node.create_subscription(Twist, wanted, take, 10)

    def state(self) -> dict[str, Any]:
        """Return the value of the lock, None before its first message, and the passed count."""
        return {"locked": self.locked, "passed": self.passed}

    def _take_lock(self, message: Any) -> None:
        self.locked = message.data

    def _take(self, message: Any) -> None:
        self.passed += self.locked is False


ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ParameterPeer(NodePeer):
    """Reads and sets parameters and log levels."""

    def __init__(self) -> None:
        self.node = Node("somebody_else", start_parameter_services=False)
        self.changed: list[tuple[str, str, Any]] = []
        self.node.create_subscription(ParameterEvent, "/parameter_events", self._changed, 1000)
        self._clients: dict[str, AsyncParameterClient] = {}
        self.logged: list[tuple[int, str, str]] = []
        self.node.create_subscription(Log, "/rosout", self._logged, ROSOUT)

    def _changed(self, event: Any) -> None:
        for each in event.changed_parameters:
            self.changed.append((event.node, each.name, parameter_value_to_python(each.value)))

    def _logged(self, line: Any) -> None:
        self.logged.append((line.level, line.name, line.msg))

    def visible(self) -> list[str]:
        """Return the full names of the other nodes that `ros2 node list` shows."""
        found = self.node.get_node_names_and_namespaces()
        names = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found if name[0] != "_"}
        return sorted(names - {"/somebody_else"})

    def list_all(self) -> dict[str, list[str]]:
        """List the parameters of every visible node, one after the other as `ros2 param list`."""
        nodes = self.visible()
        for node in nodes:
            self._client(node)
        return {
            node: sorted(self._done(self._client(node).list_parameters()).result.names)
            for node in nodes
        }

    def get(self, node: str, keys: list[str]) -> list[Any]:
        """Return the values of keys."""
        values = self._done(self._client(node).get_parameters(keys)).values
        return [parameter_value_to_python(value) for value in values]

    def set(self, node: str, values: dict[str, Any], atomically: bool = False) -> Any:
        """Set keys; return for each, or once if `atomically`, the success and the reason."""
        parameters = [Parameter(key, value=value) for key, value in values.items()]
        if atomically:
            result = self._done(self._client(node).set_parameters_atomically(parameters)).result
            return [(result.successful, result.reason)]
        results = self._done(self._client(node).set_parameters(parameters)).results
        return [(result.successful, result.reason) for result in results]

    def lines(self) -> list[tuple[int, str, str]]:
        """Return the log lines on /rosout: level, logger, text."""
        return self.logged

    def levels(self, node: str, names: list[str]) -> list[int]:
        """Return the levels of loggers."""
        request = GetLoggerLevels.Request(names=names)
        answer = self._ask(GetLoggerLevels, f"{node}/get_logger_levels", request)
        return [each.level for each in answer.levels]

    def set_levels(self, node: str, levels: dict[str, int]) -> list[tuple[bool, str]]:
        """Set the levels of loggers; return for each the success and the reason."""
        wanted = [LoggerLevel(name=name, level=level) for name, level in levels.items()]
        request = SetLoggerLevels.Request(levels=wanted)
        answer = self._ask(SetLoggerLevels, f"{node}/set_logger_levels", request)
        return [(each.successful, each.reason) for each in answer.results]

    def events(self) -> list[tuple[str, str, Any]]:
        """Return the changes that were published: node, key, value."""
        return self.changed

    def _client(self, node: str) -> AsyncParameterClient:
        if node not in self._clients:
            client = AsyncParameterClient(self.node, node)
            assert client.wait_for_services(DEADLINE_S), f"{node} has no parameter services"
            self._clients[node] = client
        return self._clients[node]

    def _done(self, future: Any) -> Any:
        until(future.done)
        return future.result()


QOS = {"system": qos_profile_system_default, "sensor": qos_profile_sensor_data}
COMMANDS = {"Twist": Twist, "TwistStamped": TwistStamped}


class StubBase(NodePeer):
    """A robot's base: it follows commands, and publishes odometry and battery."""

    def __init__(self) -> None:
        self.node = Node("stub_base")
        self.frames: set[str] = set()
        self._velocity = self._wanted = (0.0, 0.0)
        self._pose = (0.0, 0.0, 0.0)

    def begin(
        self,
        command: list[str],
        odometry: list[Any],
        battery: list[Any] | None,
        child_frame: str,
        lag_s: float = 0.0,
        deadband_mps: float = 0.0,
    ) -> None:
        """Begin. `command`: topic, type, QoS; `odometry`: topic, QoS, rate; `battery` also a level.

        The base follows with a lag, and ignores speeds below the deadband.
        """
        self._lag_s, self._deadband_mps = lag_s, deadband_mps
        topic, kind, profile = command
        self.node.create_subscription(COMMANDS[kind], topic, self._take, QOS[profile])
        self._child_frame = child_frame
        name, profile, rate_hz = odometry
        self._odometry = self.node.create_publisher(Odometry, name, QOS[profile])
        self._period_s = 1.0 / rate_hz
        self.node.create_timer(self._period_s, self._move)
        if battery is not None:
            name, profile, rate_hz, level = battery
            self._battery = self.node.create_publisher(BatteryState, name, QOS[profile])
            message = BatteryState(percentage=level)
            self.node.create_timer(1.0 / rate_hz, lambda: self._battery.publish(message))

    def driven(self) -> dict[str, Any]:
        """Return the position [m] of the base, and the frames of the received commands."""
        x, y, _ = self._pose
        return {"x": x, "y": y, "frames": sorted(self.frames)}

    def _take(self, message: Any) -> None:
        if isinstance(message, TwistStamped):
            self.frames.add(message.header.frame_id)
            message = message.twist
        self._wanted = (message.linear.x, message.angular.z)

    def _follow(self) -> tuple[float, float]:
        """Return the velocity of this period."""
        (v, w), (wanted_v, wanted_w) = self._velocity, self._wanted
        if 0.0 < abs(wanted_v) < self._deadband_mps:
            wanted_v, wanted_w = 0.0, 0.0
        share = 1.0 - math.exp(-self._period_s / self._lag_s) if self._lag_s else 1.0
        return v + share * (wanted_v - v), w + share * (wanted_w - w)

    def _move(self) -> None:
        self._velocity = self._follow()
        (v, w), (x, y, theta) = self._velocity, self._pose
        x += v * math.cos(theta) * self._period_s
        y += v * math.sin(theta) * self._period_s
        theta += w * self._period_s
        self._pose = (x, y, theta)
        message = Odometry()
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.header.frame_id, message.child_frame_id = "odom", self._child_frame
        message.pose.pose.position.x, message.pose.pose.position.y = x, y
        message.pose.pose.orientation.z = math.sin(theta / 2)
        message.pose.pose.orientation.w = math.cos(theta / 2)
        message.twist.twist.linear.x, message.twist.twist.angular.z = v, w
        self._odometry.publish(message)


if __name__ == "__main__":
    run_peer({kind.__name__: kind for kind in NodePeer.__subclasses__()}[sys.argv[1]])
