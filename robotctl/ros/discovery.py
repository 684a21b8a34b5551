# mypy: disallow-untyped-calls=False
"""Waiting until everybody in a ROS domain is discovered."""

from __future__ import annotations

import threading
import time
from typing import Final

from rclpy.node import Node

from robotctl.domains import is_on_this_machine_only, participants_here

QUIET_S: Final = 0.3
"""When as many are known as there are, and nothing has been new for so long, all is known."""

_DISCOVERY_TOPIC: Final = "ros_discovery_info"
"""Every process of ROS has one publisher and one subscriber of it."""

_POLL_S: Final = 0.02


def wait_until_all_known(
    node: Node, domain_id: int, until_s: float, stopped: threading.Event
) -> None:
    """Return when the node has discovered everybody, or at a moment of the steady clock.

    Fast DDS announces a process every 3 s by default, and about half of the greetings before that
    get lost: how many there are is counted by their ports.
    """
    known, since = _known(node), time.monotonic()
    while time.monotonic() < until_s and not stopped.wait(_POLL_S):
        if _known(node) != known:
            known, since = _known(node), time.monotonic()
        if time.monotonic() - since > QUIET_S and _knows_all(node, domain_id):
            return


def _knows_all(node: Node, domain_id: int) -> bool:
    """Never where others may be on other machines, which nobody can count."""
    here = participants_here(domain_id) if is_on_this_machine_only() else None
    return here is not None and _processes(node) >= here


def _known(node: Node) -> tuple[int, ...]:
    """What changes while others are discovered."""
    topics = node.get_topic_names_and_types(no_demangle=True)
    return len(node.get_node_names()), len(topics), _processes(node)


def _processes(node: Node) -> int:
    """How many processes of ROS are known in full, we among them."""
    return min(
        len(node.get_publishers_info_by_topic(_DISCOVERY_TOPIC, no_mangle=True)),
        len(node.get_subscriptions_info_by_topic(_DISCOVERY_TOPIC, no_mangle=True)),
    )
