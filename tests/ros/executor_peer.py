"""The peer process of the executor's tests: plain rclpy with an executor of rclpy."""

from __future__ import annotations

import os
import time
from typing import Any

from action_msgs.msg import GoalStatus
from geometry_msgs.msg import Twist
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from robot_controller.action import DrivePattern
from rosgraph_msgs.msg import Clock
from std_msgs.msg import UInt64
from std_srvs.srv import SetBool

from tests.ros.open_executor import Node
from tests.support.ros_peer import NodePeer, run_peer
from tests.support.waiting import DEADLINE_S, until


class Peer(NodePeer):
    def __init__(self) -> None:
        self.node = Node("peer")
        self.group = ReentrantCallbackGroup()
        self.kept: dict[str, Any] = {}
        self.clock = self.node.create_publisher(Clock, "/clock", 10)

    # Topics.

    def publish(self, topic: str, values: list[int]) -> int:
        """Publish to at least one subscriber, and wait until all have acknowledged."""
        publisher = self._publisher(topic)
        until(publisher.get_subscription_count)
        for value in values:
            publisher.publish(UInt64(data=value))
        publisher.wait_for_all_acked(Duration(seconds=DEADLINE_S))
        return len(values)

    def open(self, topic: str) -> None:
        """Create the publisher of a topic, if there is none."""
        self._publisher(topic)

    def flood(self, topic: str, hz: float, seconds: float) -> int:
        """Publish a counter at a rate; return the number of messages."""
        publisher = self._publisher(topic)
        until(publisher.get_subscription_count)
        sent = 0
        begun = time.monotonic()
        while (now := time.monotonic() - begun) < seconds:
            while sent < now * hz:
                publisher.publish(UInt64(data=sent))
                sent += 1
            time.sleep(0.0005)
        publisher.wait_for_all_acked(Duration(seconds=DEADLINE_S))
        return sent

    def listen(self, topic: str) -> None:
        """Subscribe to a topic."""
        self.kept[f"subscription {topic}"] = self.node.create_subscription(
            UInt64, topic, lambda message: None, 100
        )

    def take_commands(self, topic: str) -> int:
        """Subscribe to velocity commands, reliably; return the number of this process."""
        self.kept[f"subscription {topic}"] = self.node.create_subscription(
            Twist, topic, lambda message: None, 10
        )
        return os.getpid()

    def offer(self, topic: str, reliable: bool = True, deadline_s: float | None = None) -> None:
        """Create a publisher with the given QoS."""
        qos = QoSProfile(depth=10)
        qos.reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        qos.durability = DurabilityPolicy.VOLATILE
        if deadline_s is not None:
            qos.deadline = Duration(nanoseconds=round(deadline_s * 1e9))
        self.kept[f"publisher {topic}"] = self.node.create_publisher(UInt64, topic, qos)

    def withdraw(self, topic: str) -> None:
        """Destroy the publisher of `offer` or `publish`."""
        self.node.destroy_publisher(self.kept.pop(f"publisher {topic}"))

    def tell_time(self, nanoseconds: int) -> None:
        """Publish /clock."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(nanoseconds, 10**9)
        self.clock.publish(message)

    def _publisher(self, topic: str) -> Any:
        key = f"publisher {topic}"
        if key not in self.kept:
            self.kept[key] = self.node.create_publisher(UInt64, topic, 10_000)
        return self.kept[key]

    # Services.

    def serve(self, service: str, delay_s: float = 0.0) -> None:
        """Serve SetBool: success is the request's data."""

        def answer(request: Any, response: Any) -> Any:
            time.sleep(delay_s)
            response.success, response.message = request.data, "from the peer"
            return response

        self.kept[f"service {service}"] = self.node.create_service(
            SetBool, service, answer, callback_group=self.group
        )

    def call(self, service: str, data: bool, times: int = 1) -> list[Any]:
        """Call SetBool some times, one call after the other."""
        client: Any = self.node.create_client(SetBool, service, callback_group=self.group)
        assert client.wait_for_service(DEADLINE_S)
        request = SetBool.Request(data=data)
        replies = [client.call(request, DEADLINE_S) for _ in range(times)]
        self.node.destroy_client(client)
        return [[reply.success, reply.message] if reply else None for reply in replies]

    def get_parameter(self, node: str, name: str) -> Any:
        """Read an integer parameter of another node."""
        request = GetParameters.Request(names=[name])
        reply = self._ask(GetParameters, f"{node}/get_parameters", request)
        return reply.values[0].integer_value

    def set_parameter(self, node: str, name: str, value: Any) -> bool:
        """Set a parameter of another node."""
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        reply = self._ask(SetParameters, f"{node}/set_parameters", request)
        return bool(reply.results[0].successful)

    # Actions.

    def serve_action(self, action: str, step_s: float = 0.01) -> None:
        """Serve DrivePattern: count the laps, and return their sum; above 1000 are refused."""

        def accept(goal: Any) -> GoalResponse:
            return GoalResponse.REJECT if goal.laps > 1000 else GoalResponse.ACCEPT

        def execute(handle: Any) -> Any:
            # The goal may arrive before its feedback subscription is discovered.
            until(lambda: self.node.count_subscribers(f"{action}/_action/feedback"))
            total = 0
            for number in range(handle.request.laps):
                if handle.is_cancel_requested:
                    handle.canceled()
                    return DrivePattern.Result(laps=total)
                handle.publish_feedback(DrivePattern.Feedback(lap=number))
                total += number
                time.sleep(step_s)
            handle.succeed()
            return DrivePattern.Result(laps=total)

        self.kept[f"action {action}"] = ActionServer(
            self.node,
            DrivePattern,
            action,
            execute,
            callback_group=self.group,
            goal_callback=accept,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def run_goal(
        self, action: str, laps: int, cancel_after: int | None = None, feedbacks: int = 0
    ) -> dict[str, Any]:
        """Send a goal, cancel it after some feedback if wanted, and return its result.

        The result may overtake feedback: at least `feedbacks` are waited for.
        """
        client = ActionClient(self.node, DrivePattern, action, callback_group=self.group)
        assert client.wait_for_server(DEADLINE_S)
        feedback: list[int] = []
        sent = client.send_goal_async(
            DrivePattern.Goal(laps=laps),
            feedback_callback=lambda m: feedback.append(m.feedback.lap),
        )
        until(sent.done)
        handle = sent.result()
        report: dict[str, Any] = {"accepted": handle.accepted, "feedback": feedback}
        if handle.accepted:
            if cancel_after is not None:
                until(lambda: len(feedback) > cancel_after)
                cancelled = handle.cancel_goal_async()
                until(cancelled.done)
                report["cancelling"] = len(cancelled.result().goals_canceling)
            result = handle.get_result_async()
            until(result.done)
            report["succeeded"] = result.result().status == GoalStatus.STATUS_SUCCEEDED
            report["canceled"] = result.result().status == GoalStatus.STATUS_CANCELED
            report["result"] = result.result().result.laps
            until(lambda: len(feedback) >= feedbacks)
        client.destroy()
        return report


if __name__ == "__main__":
    run_peer(Peer, threads=4)
