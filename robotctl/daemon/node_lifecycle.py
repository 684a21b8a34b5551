"""The lifecycle of the node that gates motion, between ROS and the kernel."""

from __future__ import annotations

from dataclasses import replace

from robotctl.daemon.control.inputs import Inputs
from robotctl.kernel.state import Health, State
from robotctl.kernel.types.events import LifecycleState
from robotctl.ros.nodes.node_services import ManagedNode


def with_lifecycle(state: State, *, autostart: bool) -> State:
    """Return the first state of a kernel whose node is activated at once, or is not configured."""
    first = LifecycleState.ACTIVE if autostart else LifecycleState.UNCONFIGURED
    return replace(state, health=Health(lifecycle=first))


def follow_lifecycle(node: ManagedNode, inputs: Inputs, *, autostart: bool) -> None:
    """Activate the node where it activates itself, and pass its later transitions on."""
    if autostart:
        node.start()
    source = f"the lifecycle of {node.get_fully_qualified_name()}"
    node.changed = lambda state: inputs.lifecycle(state, source)
