"""The owner of the mode knows whether its commands reach a robot through a gate."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from robotctl.kernel.command_types import TWIST_STAMPED
from robotctl.ros.messages.command_type import stamped
from robotctl.ros.nodes.owner_velocity import OwnerVelocity
from robotctl.ros.session import Session

Until = Callable[[Callable[[], object]], Awaitable[None]]


async def test_a_gate_that_takes_another_type_passes_nothing_on_yet(
    session: Session, new_context: Callable[[], Any], until: Until
) -> None:
    from geometry_msgs.msg import Twist, TwistStamped
    from rclpy.node import Node

    owner = OwnerVelocity(session, "cmd_vel/owner", stamped("base_link"), lambda: False)

    def gate(kind: type) -> Any:
        made = Node("velocity_publisher", context=new_context(), namespace="/r2")
        made.create_subscription(kind, "/r2/cmd_vel/owner", print, 10)
        made.create_publisher(kind, "/r2/cmd_vel", 10)
        return made

    robot = Node("robot", context=new_context())
    robot.create_subscription(TwistStamped, "/r2/cmd_vel", print, 10)
    early = gate(Twist)
    await until(lambda: owner.gate_problem() == f"the gate does not take {TWIST_STAMPED} yet")
    early.destroy_node()
    late = gate(TwistStamped)
    await until(lambda: owner.gate_problem() == "")
    late.destroy_node()
    robot.destroy_node()
