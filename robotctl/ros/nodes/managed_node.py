"""A managed node: other programs configure, activate and deactivate it by the standard services."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle.node import LifecycleNode
from rclpy.node import Node

from robotctl.kernel.lifecycle import LifecycleState


class ManagedNode(LifecycleNode):
    """A node with the lifecycle services and `transition_event`; its own interfaces always work.

    `changed(state)` is called after each request for a transition.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.changed: Callable[[LifecycleState], None] = lambda state: None
        service: Any = self._service_change_state
        self._change: Callable[[Any, Any], Any] = service.callback
        service.callback = self._change_state

    @property
    def state(self) -> LifecycleState:
        """The present state."""
        _, label = self._state_machine.current_state
        return LifecycleState(label)

    def start(self) -> None:
        """Configure and activate the node."""
        node: Any = self  # rclpy's methods have no types
        node.trigger_configure()
        node.trigger_activate()

    def destroy_node(self) -> None:
        """Destroy the node and its state machine, which rclpy leaves: it keeps the context."""
        Node.destroy_node(self)
        self._state_machine.destroy_when_not_in_use()

    def _change_state(self, request: Any, response: Any) -> Any:
        try:
            response = self._change(request, response)
        except _rclpy.RCLError:  # this state does not have the transition
            response.success = False
        self.changed(self.state)
        return response
