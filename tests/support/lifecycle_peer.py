"""A manager of the node `mode_service`: plain rclpy in a process of its own."""

from __future__ import annotations

from typing import Any

from geometry_msgs.msg import Twist
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import (
    ChangeState,
    GetAvailableStates,
    GetAvailableTransitions,
    GetState,
)
from rclpy.node import Node

from tests.support.spinning import run_peer
from tests.support.waiting import DEADLINE_S, until


class Peer:
    def __init__(self) -> None:
        self.node = Node("manager")

    def state(self) -> str:
        """Return the label of the present state."""
        return str(self._call(GetState, "get_state", GetState.Request()).current_state.label)

    def change(self, label: str = "", id: int = 0) -> bool:  # noqa: A002 - as in the message
        """Request a transition; return whether it happened."""
        request = ChangeState.Request(transition=Transition(id=id, label=label))
        return bool(self._call(ChangeState, "change_state", request).success)

    def machine(self) -> list[list[str]]:
        """Return the labels of all states, of the transitions of this state, and of all."""
        states = self._call(
            GetAvailableStates, "get_available_states", GetAvailableStates.Request()
        )
        found = [[each.label for each in states.available_states]]
        for service in ("get_available_transitions", "get_transition_graph"):
            answer = self._call(GetAvailableTransitions, service, GetAvailableTransitions.Request())
            found.append([each.transition.label for each in answer.available_transitions])
        return found

    def zeros(self) -> int:
        """Wait for some commands; return how many are zero, -1 if one is not."""
        heard: list[float] = []

        def hear(message: Any) -> None:
            heard.append(message.linear.x)

        subscription = self.node.create_subscription(Twist, "/cmd_vel", hear, 10)
        until(lambda: len(heard) >= 3)
        self.node.destroy_subscription(subscription)
        return -1 if any(heard) else len(heard)

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        client = self.node.create_client(kind, f"/mode_service/{name}")
        assert client.wait_for_service(DEADLINE_S), "no such service"
        future = client.call_async(request)
        until(future.done)
        self.node.destroy_client(client)
        return future.result()


if __name__ == "__main__":
    run_peer(Peer)
