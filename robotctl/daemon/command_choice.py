"""Choose the type of the velocity command, before the daemon creates its publisher."""

from __future__ import annotations

import time
from dataclasses import replace

from robotctl.daemon.host import Host
from robotctl.daemon.waiting import until
from robotctl.kernel.command_types import COMMAND_TYPES, TWIST_STAMPED
from robotctl.kernel.params import CommandParams, Stamping
from robotctl.ros.graph import endpoints
from robotctl.ros.messages.command_type import PLAIN, CommandType, stamped
from robotctl.ros.messages.qos import COMMANDS
from robotctl.ros.nodes.velocity_publisher import is_monitor

PROBE_NODE = "_command_probe"
"""ROS tools hide names with a leading underscore; the node lives until a base is found."""


async def choose_command_type(host: Host) -> CommandType:
    """Return the configured type; for `auto`, the one that the subscribers of the topic take.

    Where no base is found until the end of discovery, or none is looked for, that is Twist.
    """
    command = host.config.kernel.command
    looks = not (host.alone or host.options.sim)
    if command.stamped is Stamping.AUTO and looks:
        chosen = await _taken_type(host, command)
    else:
        chosen = stamped(command.frame_id) if command.stamped is Stamping.TRUE else PLAIN
    return replace(chosen, qos=COMMANDS[command.qos])


async def _taken_type(host: Host, command: CommandParams) -> CommandType:
    node = host.session.node(PROBE_NODE)

    def taken() -> frozenset[str]:
        found = endpoints.subscriptions(node, host.session.resolve(command.topic))
        types = (each.topic_type for each in found if not is_monitor(each.node_name))
        return COMMAND_TYPES.intersection(types)

    try:
        remaining_s = host.discovered_by_s - time.monotonic()
        await until(lambda: bool(taken()) or host.stop.is_set(), remaining_s)
        return stamped(command.frame_id) if taken() == {TWIST_STAMPED} else PLAIN
    finally:
        host.session.remove(node)
