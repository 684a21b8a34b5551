# mypy: disallow-untyped-calls=False
"""Requests a mode from the service `set_mode`, and prints the response."""

from __future__ import annotations

import asyncio
import sys

from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from robot_controller.srv import SetMode

from robotctl.base.errors import NoDaemon, Refused, UsageError
from robotctl.base.text import find_mode
from robotctl.kernel.modes import Mode
from robotctl.ros.executables.process import opened_node
from robotctl.ros.nodes.mode_service import SET_MODE

SERVICE_S = 5.0
"""How long to look for the service."""

ANSWER_S = 30.0
"""How long to wait for the response. A request for IDLE is answered only after the ramp."""


def mode_of(text: str) -> Mode:
    """Return the mode for `text`, a number or a name in any case, with "-" or "_".

    Raises:
        UsageError: There is no such mode.
    """
    number = find_mode(text)
    if number is None:
        names = ", ".join(mode.name for mode in Mode)
        raise UsageError(f"no mode {text!r}", f"use {names}, or 0 to {max(Mode).value}")
    return Mode(number)


async def ask(mode: Mode) -> SetMode.Response:
    """Request `mode` from the service `set_mode`, and return the response.

    Raises:
        NoDaemon: The service does not exist, or does not respond.
    """
    async with opened_node(
        lambda context: Node("mode_client", context=context, start_parameter_services=False)
    ) as (node, executor):
        client = node.create_client(SetMode, SET_MODE)
        name = node.resolve_service_name(SET_MODE)
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


def main() -> int:
    """Request the mode on the command line, and return 0 or the exit code of a refusal.

    Raises:
        UsageError: The command line does not have exactly one mode.
        NoDaemon: The service does not exist, or does not respond.
    """
    words = remove_ros_args(sys.argv)[1:]
    if len(words) != 1:
        raise UsageError("one mode is needed", "mode_client MOVING")
    answer = asyncio.run(ask(mode_of(words[0])))
    print(
        f"success={answer.success}, message={answer.message!r}, current_mode={answer.current_mode}"
    )
    return 0 if answer.success else Refused.exit_code
