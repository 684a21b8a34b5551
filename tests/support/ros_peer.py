"""A peer on the graph: plain rclpy in a separate process, which executes a test's commands."""

from __future__ import annotations

import threading
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped, Vector3
from nav_msgs.msg import Odometry, Path
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from robot_controller.msg import RobotStatus
from robot_controller.srv import SetMode
from sensor_msgs.msg import BatteryState, Joy
from std_msgs.msg import Bool, String, UInt8MultiArray
from std_srvs.srv import Trigger

from tests.support.lines import obey
from tests.support.waiting import DEADLINE_S, until


class NodePeer:
    """A peer; a test calls its public methods through `lines.Told`."""

    node: Node

    def end(self) -> None:
        """Destroy what `destroy_node` leaves."""

    def _ask(self, kind: Any, service: str, request: Any) -> Any:
        """Call a service, and return its response."""
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(DEADLINE_S), f"no service {service}"
        future = client.call_async(request)
        until(future.done)
        self.node.destroy_client(client)
        return future.result()


def fields(message: Any) -> dict[str, Any]:
    """Return the fields of a message."""
    return {name: getattr(message, name) for name in message.get_fields_and_field_types()}


def run_peer(make: Callable[[], NodePeer], *, threads: int = 1) -> None:
    """Run the process of a peer until stdin is closed."""
    rclpy.init(args=[])
    peer = make()
    with spinning(peer.node, threads):
        obey(peer)
    peer.end()
    peer.node.destroy_node()
    rclpy.shutdown()


@contextmanager
def spinning(node: Node, threads: int = 1) -> Iterator[None]:
    """Run the callbacks of the node until the end of the block."""
    executor: Any = (
        SingleThreadedExecutor(context=node.context)
        if threads == 1
        else MultiThreadedExecutor(threads, context=node.context)
    )
    executor.add_node(node)
    spinner = threading.Thread(target=executor.spin)
    spinner.start()
    try:
        yield
    finally:
        executor.shutdown()
        spinner.join()


@contextmanager
def node_in(domain_id: int, name: str) -> Iterator[Node]:
    """Make a node in a context of its own, and run its callbacks until the end of the block."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=domain_id)
    node = Node(name, context=context)
    try:
        with spinning(node):
            yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
REQUESTS = QoSProfile(depth=1_500)
DEEP = QoSProfile(depth=10_000)
BEST_EFFORT = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)


class Peer(NodePeer):
    """The other node of most tests of a daemon: it subscribes, publishes and calls services."""

    def __init__(self) -> None:
        self.node = Node("somebody_else")
        self.commands: list[tuple[int, int, float, float]] = []
        self.marks: list[str] = []
        self.speed = 0.0
        self._clients: dict[str, Any] = {}
        self._asked: list[Any] = []
        self._buttons: dict[str, Any] = {}
        self._gamepad = Joy()
        self._pressing: Any = None
        self._planner: Any = None

    def listen(self) -> None:
        """Subscribe to the daemon's topics and /odom; `heard` returns what was received."""

        def command(message: Any, info: Any) -> None:
            number = info["publication_sequence_number"]
            seen_ns = time.monotonic_ns()
            self.commands.append((number, seen_ns, message.linear.x, message.angular.z))

        def odometry(message: Any) -> None:
            self.speed = message.twist.twist.linear.x

        def mark(message: Any) -> None:
            self.marks.append(message.data)

        self._subscribe(Twist, "/cmd_vel", command, DEEP)
        self._subscribe(Odometry, "/odom", odometry, BEST_EFFORT)
        self._subscribe(String, "/robotctl/marks", mark, DEEP)

    def heard(self) -> dict[str, Any]:
        """Return all received commands and marks, and the last speed."""
        return {"commands": self.commands, "marks": self.marks, "speed": self.speed}

    def set_mode(self, mode: int, namespace: str = "") -> dict[str, Any]:
        """Call `set_mode` and return the response."""
        request = SetMode.Request(requested_mode=mode)
        return fields(self._ask(SetMode, f"{namespace}/set_mode", request))

    def ask(self, service: str, mode: int = 0, namespace: str = "") -> int:
        """Begin a call of `set_mode` or `estop`; return its number for `answer`."""
        client = self._clients.get(service)
        if client is None:
            kind = {"set_mode": SetMode, "estop": Trigger}[service]
            client = self.node.create_client(kind, f"{namespace}/{service}", qos_profile=REQUESTS)
            assert client.wait_for_service(DEADLINE_S), "no such service"
            self._clients[service] = client
        request = SetMode.Request(requested_mode=mode) if service == "set_mode" else None
        self._asked.append(client.call_async(request or Trigger.Request()))
        return len(self._asked) - 1

    def answer(self, number: int) -> dict[str, Any]:
        """Wait for the answer to a call."""
        until(self._asked[number].done)
        return fields(self._asked[number].result())

    def flood(self, count: int, in_flight: int) -> dict[str, int]:
        """Call both services `count` times, up to `in_flight` calls at once; return the counts."""
        kinds = [("set_mode", mode) for mode in (0, 1, 2, 3, 7)] + [("estop", 0)]
        stops: list[Any] = []
        others: list[Any] = []
        for number in range(count):
            kind = kinds[number % len(kinds)]
            future = self._asked[self.ask(*kind)]
            (stops if kind in (("set_mode", 3), ("estop", 0)) else others).append(future)
            if number % in_flight == in_flight - 1:
                with suppress(AssertionError):
                    until(lambda: all(each.done() for each in stops + others))
        with suppress(AssertionError):
            until(lambda: all(each.done() for each in stops + others))
        return {
            "sent": len(stops) + len(others),
            "answered": sum(each.done() for each in stops + others),
            "stops": len(stops),
            "obeyed": sum(each.done() and each.result().success for each in stops),
        }

    def late_status(self) -> list[Any]:
        """Subscribe now; return the first status and its sequence number."""
        got: list[Any] = []

        def status(message: Any, info: Any) -> None:
            got.append([message.mode, info["publication_sequence_number"]])

        subscription = self._subscribe(RobotStatus, "/robot_status", status, LATCHED)
        until(lambda: got)
        self.node.destroy_subscription(subscription)
        return list(got[0])

    def be_a_robot(self) -> None:
        """Publish odometry and a full battery until the end."""
        battery = self.node.create_publisher(BatteryState, "/battery_state", 10)
        self.node.create_timer(0.02, lambda: battery.publish(BatteryState(percentage=1.0)))
        self.measure(0.0)

    def command(self, linear: float) -> None:
        """Publish a velocity command, in competition with the daemon."""
        self.node.create_publisher(Twist, "/cmd_vel", 10).publish(_forward(linear))

    def command_and_go(self, linear: float) -> int:
        """Publish one command once there is a subscriber, then destroy the publisher.

        Return the monotonic time [ns] just before the command was sent.
        """
        publisher = self.node.create_publisher(Twist, "/cmd_vel", DEEP)
        until(lambda: publisher.get_subscription_count() >= 2)  # robot and recorder
        sent_ns = time.monotonic_ns()
        self._publish_and_go(publisher, _forward(linear))
        return sent_ns

    def command_best_effort(self, linear: float) -> None:
        """Publish best-effort commands for 0.1 s, then destroy the publisher."""
        publisher = self.node.create_publisher(Twist, "/cmd_vel", BEST_EFFORT)
        until(publisher.get_subscription_count)
        for _ in range(5):
            publisher.publish(_forward(linear))
            time.sleep(0.02)
        self.node.destroy_publisher(publisher)

    def measure(self, x: float) -> None:
        """Publish odometry with position `x` at 100 Hz until the end."""
        odometry = self.node.create_publisher(Odometry, "/odom", 10)
        message = Odometry()
        message.pose.pose.position.x, message.pose.pose.orientation.w = x, 1.0

        def publish() -> None:
            message.header.stamp = self.node.get_clock().now().to_msg()
            odometry.publish(message)

        self.node.create_timer(0.01, publish)

    def take_commands(self, kind: str) -> None:
        """Subscribe to the command topic with this type."""
        message_type = {"Twist": Twist, "TwistStamped": TwistStamped}[kind]
        self._subscribe(message_type, "/cmd_vel", lambda message: None, DEEP)

    def publish(self, kind: str, topic: str) -> None:
        """Create the publisher of a topic with a type of this name."""
        self.node.create_publisher({"Twist": Twist, "Odometry": Odometry}[kind], topic, 10)

    def send(self, kind: str, topic: str, count: int) -> None:
        """Publish messages once there is a subscriber; wait until they are acknowledged."""
        message_type = {"Twist": Twist, "Odometry": Odometry}[kind]
        publisher = self.node.create_publisher(message_type, topic, DEEP)
        self._publish_and_go(publisher, *[message_type() for _ in range(count)])

    def press(self, topic: str, pressed: bool) -> None:
        """Publish a Bool once there is a subscriber."""
        publisher = self._buttons.get(topic)
        if publisher is None:
            publisher = self._buttons[topic] = self.node.create_publisher(Bool, topic, 10)
        until(publisher.get_subscription_count)
        publisher.publish(Bool(data=pressed))

    def hold_gamepad(self, topic: str, pressed: bool) -> None:
        """Be a gamepad at 50 Hz, its stick forward, with button 4 pressed or not."""
        self._gamepad = Joy(axes=[0.0, 1.0], buttons=[0, 0, 0, 0, int(pressed)])
        if self._pressing is None:
            publisher = self.node.create_publisher(Joy, topic, DEEP)
            self._pressing = self.node.create_timer(0.02, lambda: publisher.publish(self._gamepad))

    def plan(self, topic: str, points: list[list[float]], frame: str) -> None:
        """Publish a path, latched for later subscribers."""
        path = Path()
        path.header.frame_id = frame
        for x, y in points:
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y = x, y
            path.poses.append(pose)
        self._planner = self._planner or self.node.create_publisher(Path, topic, LATCHED)
        self._planner.publish(path)

    def send_large(self, topic: str, size: int) -> None:
        """Publish one message of `size` bytes once there is a subscriber."""
        publisher = self.node.create_publisher(UInt8MultiArray, topic, 1)
        self._publish_and_go(publisher, UInt8MultiArray(data=array("B", bytes(size))))

    def _publish_and_go(self, publisher: Any, *messages: Any) -> None:
        """Publish once there is a subscriber; destroy the publisher when all is acknowledged."""
        until(publisher.get_subscription_count)
        for message in messages:
            publisher.publish(message)
        assert publisher.wait_for_all_acked(Duration(seconds=DEADLINE_S))
        self.node.destroy_publisher(publisher)

    def nodes(self) -> list[str]:
        """Return the full names of all other nodes."""
        found = self.node.get_node_names_and_namespaces()
        names = {f"{namespace.rstrip('/')}/{name}" for name, namespace in found}
        return sorted(names - {"/somebody_else"})

    def publishers(self) -> dict[str, list[str]]:
        """Return topic -> the other nodes that publish on it."""
        found = {}
        for topic, _ in self.node.get_topic_names_and_types():
            infos = self.node.get_publishers_info_by_topic(topic)
            names = {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in infos}
            found[topic] = sorted(names - {"/somebody_else"})
        return {topic: names for topic, names in found.items() if names}

    def services(self) -> list[str]:
        """Return the services of all other nodes."""
        found = [name for name, _ in self.node.get_service_names_and_types()]
        return sorted(name for name in found if not name.startswith("/somebody_else/"))

    def _subscribe(self, kind: Any, topic: str, callback: Any, qos: QoSProfile) -> Any:
        # rclpy's types allow callbacks of one argument only.
        return self.node.create_subscription(kind, topic, callback, qos)


def _forward(linear: float) -> Twist:
    return Twist(linear=Vector3(x=linear))


if __name__ == "__main__":
    run_peer(Peer)
