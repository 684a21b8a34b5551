"""Whether anybody takes part in a ROS domain, without joining it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_PORT_BASE: Final = 7400
_PORTS_PER_DOMAIN: Final = 250
"""The well-known ports of a domain (DDSI-RTPS 2.5, 9.6.2.3, Well-known Ports)."""

_TABLES: Final = ("/proc/net/udp", "/proc/net/udp6")


def may_be_used_here(domain_id: int) -> bool:
    """Whether a port of the domain is bound on this machine; True where that cannot be seen."""
    first = _PORT_BASE + _PORTS_PER_DOMAIN * domain_id
    ports = range(first, first + _PORTS_PER_DOMAIN)
    seen = False
    for table in _TABLES:
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:  # no IPv6, or no /proc
            continue
        seen = True
        if any(int(line.split()[1].rpartition(":")[2], 16) in ports for line in lines):
            return True
    return not seen
