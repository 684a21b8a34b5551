# mypy: disallow-untyped-calls=False, disallow-subclassing-any=False
"""Node `velocity_publisher` of the first-package tutorial, and the gate of an owner of the mode."""

from __future__ import annotations

import math
import time
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterValueException
from rclpy.node import Node

from robotctl.cdr.motion import frame_id_of
from robotctl.domains import wider_discovery
from robotctl.kernel.command_types import COMMAND_TYPES, TWIST_STAMPED
from robotctl.kernel.params import OWNER_SUFFIX
from robotctl.kernel.types import ZERO
from robotctl.kernel.types import Twist as Velocity
from robotctl.printable import short_name
from robotctl.ros.executables.command_gate import SILENCE_S, CommandGate
from robotctl.ros.executables.process import LOGGER_SERVICES, run_node
from robotctl.ros.executables.sweep import sweep_mps
from robotctl.ros.executor import RawTap
from robotctl.ros.graph import endpoints
from robotctl.ros.graph.publishers import TOOL_NODES, full_name, gid_of
from robotctl.ros.messages.command_type import PLAIN, CommandType, stamped
from robotctl.ros.messages.no_events import NO_SUBSCRIPTION_EVENTS
from robotctl.ros.nodes.velocity_publisher import (
    MONITORS,
    NODE_NAME,
    OWNER_NODE,
    command_topic,
    publishing_line,
)

FRAME_ID = "base_link"
"""The frame of a TwistStamped before the owner has named one."""

TICK_S = 0.05
"""The time between two looks for a silent owner, and between two zeros while it is silent."""

TICKS_PER_LOOK = 4
TICKS_PER_STEP = 10
"""A step is a message of the tutorial: each 0.5 s."""

QUIET_STEPS = 8
"""The first steps, 4 s of zeros, during which an owner and other nodes are discovered."""

MAX_LINEAR_MPS = 2.0
MAX_ANGULAR_RPS = 2.0

OWN_LISTENERS = (*MONITORS, "simulated_robot")
"""Nodes of robotctl that receive commands and move no real robot."""

ACKNOWLEDGED_S = 1.0
"""How long the end waits until every reliable subscriber has the last zero."""


class VelocityPublisher(Node):
    """Publishes `cmd_vel`: what the owner of the mode commands, or alone the tutorial's sweep.

    With an owner, which publishes on `cmd_vel/owner`, this node is its gate (see `gate.Gate`), with
    messages of the owner's type, Twist or TwistStamped, and never sweeps again. Alone it publishes
    zeros for 4 s, then a sweep from -2 to 2 m/s in steps of 0.1 each 0.5 s. It publishes zeros
    instead, and logs why, while another node publishes the topic, while one that may be a robot
    subscribes to it, or where discovery reaches beyond this machine.

    The parameter `sweep` set to true sweeps anyway, set to false never. The method `set_velocity`
    ends the sweep.
    """

    def __init__(self, context: Context | None = None, **options: Any) -> None:
        """Create the node and its timer; `options` are those of rclpy's Node."""
        super().__init__(NODE_NAME, context=context, **{**LOGGER_SERVICES, **options})
        self._may_sweep = self._sweep_parameter()
        self._gate = CommandGate(self._silence_parameter())
        self._ticks = 0
        self._steps = 0
        self._asked: tuple[float, float] | None = None
        self._last = ZERO
        self._said = ""
        self._own_gid = b""
        self._connect(PLAIN)
        # Steady: zeros must not wait for a /clock that stands still.
        self.create_timer(TICK_S, self._tick, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info("Velocity Publisher Node started")

    def set_velocity(self, linear: float, angular: float) -> None:
        """Publish this velocity [m/s, rad/s] from now on, within +-2 m/s and +-2 rad/s.

        While there is an owner of the mode, only its commands are published.

        Raises:
            ValueError: A number is not finite.
        """
        if not math.isfinite(linear) or not math.isfinite(angular):
            raise ValueError(f"a velocity is finite, not {linear}, {angular}")
        limited = (
            min(max(float(linear), -MAX_LINEAR_MPS), MAX_LINEAR_MPS),
            min(max(float(angular), -MAX_ANGULAR_RPS), MAX_ANGULAR_RPS),
        )
        if limited != (linear, angular):
            self.get_logger().warning(
                f"limited to linear.x={limited[0]}, angular.z={limited[1]}: "
                f"at most {MAX_LINEAR_MPS} m/s and {MAX_ANGULAR_RPS} rad/s"
            )
        self._asked = limited

    def obstacle(self) -> str:
        """Return why the sweep may not run now, "" where it may."""
        other = self._other_publisher()
        if other:
            return other
        topic = self._topic
        for each in endpoints.subscriptions(self, topic):
            if each.node_name not in OWN_LISTENERS and not each.node_name.startswith(TOOL_NODES):
                return f"{_name(each)} takes {topic} and may be a robot"
        wider = wider_discovery()
        return f"discovery reaches beyond this machine ({wider})" if wider else ""

    def stop(self) -> None:
        """Publish a last zero, and wait until reliable subscribers have it."""
        self._send(ZERO)
        self._publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGED_S))

    @property
    def _topic(self) -> str:
        return str(self._publisher.topic_name)

    def _sweep_parameter(self) -> bool | None:
        """Declare `sweep`; return its value, None for the default: only where nothing can move."""
        dynamic = ParameterDescriptor(
            description="true: sweep anyway; false: never; unset: where no robot can be",
            dynamic_typing=True,
            read_only=True,
        )
        given = self.declare_parameter("sweep", None, dynamic)
        if not isinstance(given.value, bool | None):
            raise InvalidParameterValueException("sweep", given.value, "sweep is true or false")
        return given.value

    def _silence_parameter(self) -> float:
        """Declare `silence_s`; return its value [s]."""
        ranged = ParameterDescriptor(
            description="seconds without a command of the owner after which zeros are sent",
            floating_point_range=[FloatingPointRange(from_value=0.05, to_value=10.0)],
            read_only=True,
        )
        return float(self.declare_parameter("silence_s", SILENCE_S, ranged).value)

    # The gate

    def _connect(self, kind: CommandType) -> None:
        """Take and send commands of this type."""
        self._kind = kind
        self._next_kind: CommandType | None = None
        self._frame_id = FRAME_ID
        tap: Any = RawTap(self._command, latency_s=0.0)
        owned = command_topic(f"{self.resolve_topic_name('cmd_vel')}{OWNER_SUFFIX}", kind)
        # Before the publisher: who discovers the publisher must know it for a gate.
        self._owned = self.create_subscription(
            kind.message_class,
            owned.name,
            tap,
            owned.qos,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
            raw=True,
        )
        self._publisher = command_topic("cmd_vel", kind).create_publisher(self)
        self._own_gid = gid_of(self._publisher)

    def _follow_type(self, type_name: str) -> None:
        """Change to the type of the owner: what it commands in another type is not heard."""
        if type_name not in COMMAND_TYPES - {self._kind.type_name}:
            return
        if self._last != ZERO:  # of the sweep
            self._send(ZERO)
        self.destroy_subscription(self._owned)
        self.destroy_publisher(self._publisher)
        self._next_kind = stamped(FRAME_ID) if type_name == TWIST_STAMPED else PLAIN
        self.get_logger().info(f"passing on {type_name}")

    def _command(
        self, data: bytes, received_ns: int, source_ns: int, sequence: int, gid: bytes
    ) -> None:
        """Take a command from the owner's topic."""
        try:
            velocity = self._kind.decode(data)
        except Exception:  # noqa: BLE001 - no received bytes may open the gate
            velocity = Velocity(math.nan, math.nan)
        passes = self._gate.passes(gid, velocity, time.time_ns() - source_ns, time.monotonic_ns())
        if passes is None:
            return
        if self._kind.type_name == TWIST_STAMPED and frame_id_of(data) != self._frame_id:
            self._frame_id = frame_id_of(data)
            self._kind = stamped(self._frame_id)
        finite = math.isfinite(velocity.linear) and math.isfinite(velocity.angular)
        self._send(velocity if passes and finite else ZERO)

    def _send(self, velocity: Velocity) -> None:
        if self._next_kind is not None:
            return
        self._publisher.publish(self._kind.encode(velocity))
        self._last = velocity

    def _look(self) -> None:
        found = endpoints.publishers(self, str(self._owned.topic_name))
        owners = [each for each in found if each.node_name == OWNER_NODE]
        self._gate.look([each.gid for each in owners], self._other_publisher(), time.monotonic_ns())
        if len(owners) == 1:
            self._follow_type(owners[0].topic_type)

    def _other_publisher(self) -> str:
        """Return a sentence on another publisher of the topic, "" where there is none."""
        if self.count_publishers(self._topic) > 1:
            for each in endpoints.publishers(self, self._topic):
                if each.gid != self._own_gid:
                    return f"{_name(each)} publishes {self._topic} too"
        return ""

    # The timer

    def _tick(self) -> None:
        self._ticks += 1
        if self._next_kind is not None:  # what it replaces is gone since the last tick
            self._connect(self._next_kind)
        elif self._ticks % TICKS_PER_LOOK == 0:
            self._look()
        if self._next_kind is not None:
            return
        if self._gate.needs_zero(time.monotonic_ns()):
            self._send(ZERO)
        if self._ticks % TICKS_PER_STEP:
            return
        if self._gate.had_owner:
            self._say(self._gate.closed_because(time.monotonic_ns()))
        else:
            self._send(Velocity(*self._velocity_alone()))
        self.get_logger().info(publishing_line(self._last))

    def _velocity_alone(self) -> tuple[float, float]:
        if self._asked is not None:
            return self._asked
        if self._ticks <= QUIET_STEPS * TICKS_PER_STEP:
            return 0.0, 0.0
        if self._may_sweep is False:
            self._say("no owner of the mode, and sweep is false")
            return 0.0, 0.0
        why = "" if self._may_sweep else self.obstacle()
        cure = "sweep all the same: --ros-args -p sweep:=true"
        self._say(f"{why}: publishing zeros ({cure})" if why else "")
        if why:
            self._steps = 0
            return 0.0, 0.0
        self._steps += 1
        return sweep_mps(self._steps - 1), 0.0

    def _say(self, why: str) -> None:
        """Log why zeros are published, once; "" where they are not."""
        if why != self._said:
            self._said = why
            if why:
                self.get_logger().warning(why if "zeros" in why else f"{why}: publishing zeros")


def _name(endpoint: endpoints.Endpoint) -> str:
    return short_name(full_name(endpoint)) or "a node whose name is not known yet"


def main() -> int:
    """Run the node until Ctrl-C; return the exit code."""
    return run_node(VelocityPublisher, VelocityPublisher.stop)
