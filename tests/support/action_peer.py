"""A client of the action `drive_pattern`: plain rclpy in a process of its own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.qos import QoSProfile
from robot_controller.action import DrivePattern

from tests.support.lines import obey
from tests.support.spinning import spinning
from tests.support.waiting import DEADLINE_S, until

DEEP = QoSProfile(depth=1_500)
"""For the answers to a flood; the default of rclpy keeps 10."""

STATUS = {
    getattr(GoalStatus, f"STATUS_{name}"): name
    for name in ("UNKNOWN", "ACCEPTED", "EXECUTING", "SUCCEEDED", "CANCELED", "ABORTED")
}


class Peer:
    def __init__(self) -> None:
        self.node = Node("action_client")
        self.client = ActionClient(
            self.node, DrivePattern, "drive_pattern", goal_service_qos_profile=DEEP
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
        """Cancel a goal; return the number of goals that are cancelled."""
        return len(self._answer(self.sent[number].cancel_goal_async).goals_canceling)

    def result(self, number: int) -> dict[str, Any]:
        """Wait for the result of a goal."""
        response = self._answer(self.sent[number].get_result_async)
        fields = response.result.get_fields_and_field_types()
        values = {name: getattr(response.result, name) for name in fields}
        return {"status": STATUS[response.status], **values}

    def begin_flood(self, count: int) -> None:
        """Send many goals at once."""
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
        """Call `ask` in the thread of the executor.

        rclpy notes a request after it was sent: elsewhere the answer may come before, and is lost.
        """
        executor = self.node.executor
        assert executor is not None
        asked = executor.create_task(ask)
        until(asked.done)
        return asked.result()


def _goal(values: dict[str, Any]) -> Any:
    return DrivePattern.Goal(**{name: _number(value) for name, value in values.items()})


def _number(value: Any) -> Any:
    """Return nan for the text "nan", which JSON has no number for."""
    return float(value) if value in ("nan", "inf") else value


def main() -> None:
    rclpy.init(args=[])
    peer = Peer()
    with spinning(peer.node):
        obey(peer)
    peer.client.destroy()
    peer.node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
