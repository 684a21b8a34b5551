"""Refuse a start while another daemon runs whose nodes have the same names."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from typing import Final

from robotctl.base.errors import Refused
from robotctl.config.ros_settings import MODE_SERVICE, NODES
from robotctl.daemon.host import Host

STABLE_S: Final = 0.6
"""No new node for this long: all are discovered. Daemons announce themselves every 0.5 s."""

LOOK_S: Final = 0.05


async def refuse_same_names(host: Host) -> None:
    """Wait until the other nodes of the domain are discovered; refuse a second mode service.

    Both would serve the same requests and command the same robot. It is looked for before this
    daemon has a publisher that could disturb the other one.

    Raises:
        Refused: Another daemon has the names, and the options do not allow that.
    """
    options = host.options
    if host.alone or options.allow_same_names:
        return
    names = options.ros.node_names
    own = {node: f"{options.namespace}/{names.get(node, node)}" for node in NODES}
    node = host.session.helper()
    before: Counter[str] = Counter()
    changed = time.monotonic()
    while not host.stop.is_set():
        found = Counter(
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in node.get_node_names_and_namespaces()
        )
        if own[MODE_SERVICE] in found:
            same = ", ".join(name for name in own.values() if name in found)
            raise Refused(
                f"another daemon in ROS domain {options.domain_id} has the same nodes: {same}",
                "give this one another name (--robot NAME) or domain (--domain-id N); "
                "--allow-same-names starts it all the same",
            )
        now = time.monotonic()
        if found != before:
            before, changed = found, now
        is_stable = found.total() > 1 and now - changed >= STABLE_S
        if is_stable or now >= host.discovered_by_s:
            return
        await asyncio.sleep(LOOK_S)
