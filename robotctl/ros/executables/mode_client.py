# mypy: disallow-untyped-calls=False
"""Requests a mode from the service `set_mode`, and prints the response."""

from __future__ import annotations

import asyncio
import sys

from rclpy.context import Context
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from robot_controller.srv import SetMode

from robotctl.errors import NoDaemon, Refused, RobotctlError, UsageError
from robotctl.kernel.modes import Mode
from robotctl.ros.context import close_context
from robotctl.ros.executor import AsyncioExecutor
from robotctl.ros.nodes.mode_service import SET_MODE

SERVICE_S = 5.0
"""How long to look for the service."""

ANSWER_S = 30.0
"""How long to wait for the response: a request for IDLE is answered after the ramp."""


def mode_of(text: str) -> Mode:
    """Return the mode that a text names: a number 0 to 3, or a name in any case, with - or _.

    Raises:
        UsageError: There is no such mode.
    """
    name = text.strip().upper().replace("-", "_")
    for mode in Mode:
        if name in (mode.name, str(mode.value)):
            return mode
    names = ", ".join(mode.name for mode in Mode)
    raise UsageError(f"no mode {text!r}", f"use {names}, or 0 to {max(Mode).value}")


async def ask(mode: Mode) -> SetMode.Response:
    """Call the service and return its response.

    Raises:
        NoDaemon: The service does not exist, or does not respond.
    """
    context = Context()
    context.init(args=sys.argv)
    node = Node("mode_client", context=context, start_parameter_services=False)
    try:
        client = node.create_client(SetMode, SET_MODE)
        name = node.resolve_service_name(SET_MODE)
        async with AsyncioExecutor(context) as executor:
            executor.add_node(node)
            try:
                await executor.wait_for_service(client, timeout_s=SERVICE_S)
            except TimeoutError:
                raise NoDaemon(
                    f"no service {name} within {SERVICE_S:g} s",
                    "start one: robotctl start, or: ros2 run robot_controller mode_service",
                ) from None
            request = SetMode.Request(requested_mode=mode.value)
            try:
                return await executor.call(client, request, timeout_s=ANSWER_S)
            except TimeoutError:
                raise NoDaemon(f"{name} did not answer in {ANSWER_S:g} s") from None
    finally:
        close_context(context, [node])


def main() -> int:
    """Request the mode that the command line names; return 0, 2, 3 or 4 (see docs/ros.md)."""
    try:
        words = remove_ros_args(sys.argv)[1:]
        if len(words) != 1:
            raise UsageError("one mode is needed", "mode_client MOVING")
        answer = asyncio.run(ask(mode_of(words[0])))
        print(
            f"success={answer.success}, message={answer.message!r}, "
            f"current_mode={answer.current_mode}"
        )
        if not answer.success:
            raise Refused(answer.message)
    except KeyboardInterrupt:
        print("Shutting down ...", file=sys.stderr)
        return 0
    except RobotctlError as error:
        if not isinstance(error, Refused):
            print(f"mode_client: {error}", file=sys.stderr)
        return error.exit_code
    return 0
