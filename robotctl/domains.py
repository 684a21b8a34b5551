"""Which ROS domains are in use on this machine, read from the ports that their processes bind."""

from __future__ import annotations

import os
from pathlib import Path

from robotctl.errors import Refused

DOMAINS = range(1, 102)
"""Not 0, where everybody is who did not choose; above 101 the ports are Linux's ephemeral ones."""

_PORT_BASE, _PORTS_PER_DOMAIN = 7400, 250
"""The well-known ports of a domain (DDSI-RTPS 2.5, 9.6.2.3, Well-known Ports)."""

_TABLES = ("/proc/net/udp", "/proc/net/udp6")


def free_domain() -> int:
    """A domain of which no discovery or data port is bound here.

    Chosen at random, so that two that look at the same time rarely meet. Raises Refused when all
    are taken.
    """
    taken = domains_in_use() | {int(os.environ.get("ROS_DOMAIN_ID") or 0)}
    free = [domain for domain in DOMAINS if domain not in taken]
    if not free:
        raise Refused("every ROS domain from 1 to 101 is in use on this machine: stop one")
    return free[int.from_bytes(os.urandom(8)) % len(free)]


def domains_in_use() -> set[int]:
    """The domains that a process of this machine takes part in.

    A port of another program may add one too many; without /proc none is found.
    """
    return {(port - _PORT_BASE) // _PORTS_PER_DOMAIN for port in _bound_udp_ports()}


def _bound_udp_ports() -> set[int]:
    ports = set()
    for table in _TABLES:
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:  # no IPv6, or no /proc
            continue
        ports |= {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    return ports
