"""ROS domains, with their discovery, use and reservation on this machine."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from robotctl.base.errors import Refused, UsageError

MAX_DOMAIN_ID = 232
"""The last ROS domain whose ports exist (DDSI-RTPS 2.5, 9.6.2.3)."""

DOMAINS = range(1, 102)
"""The domains that can be reserved. 0 is the default of every process; the ports of domains above
101 are ephemeral ports of Linux."""

_PORT_BASE, _PORTS_PER_DOMAIN = 7400, 250
"""The well-known ports of a domain (DDSI-RTPS 2.5, 9.6.2.3, Well-known Ports)."""

_FIRST_OWN_PORT = 10
"""The offset of the first participant's port for discovery, which is even."""

_RESERVATION = 9
"""The offset of the port that reserves a domain; DDS does not use it."""

_WIDER_RANGES = ("SUBNET", "SYSTEM_DEFAULT", "")
"""The discovery ranges beyond this machine; ROS treats an empty one as SUBNET."""

_PEERS = ("ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")
"""Variables that name other machines to discover."""

_TABLES = ("/proc/net/udp", "/proc/net/udp6")


def requested_domain(given: int | None) -> int | None:
    """Return `given` (--domain-id) or else ROS_DOMAIN_ID, None if both are unset.

    Raises:
        UsageError: The number is not a ROS domain.
    """
    text = os.environ.get("ROS_DOMAIN_ID")
    name, value = ("ROS_DOMAIN_ID", text) if given is None else ("--domain-id", str(given))
    if not value:
        return None
    if not value.isdecimal() or int(value) > MAX_DOMAIN_ID:
        raise UsageError(f"{name} is {value!r}", f"use 0 to {MAX_DOMAIN_ID}")
    return int(value)


def discovery_range() -> str:
    """Return the value of ROS_AUTOMATIC_DISCOVERY_RANGE, SUBNET if it is not set."""
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")


def wider_discovery() -> str:
    """Return the setting that makes this process discover other machines, "" if none does."""
    if discovery_range() == "OFF":
        return ""
    if discovery_range() in _WIDER_RANGES:
        return f"ROS_AUTOMATIC_DISCOVERY_RANGE is {discovery_range() or 'empty'}"
    return next((f"{name} is {os.environ[name]}" for name in _PEERS if os.environ.get(name)), "")


def is_on_this_machine_only() -> bool:
    """Return whether discovery is limited to this machine."""
    return not wider_discovery()


def is_certainly_empty(domain_id: int) -> bool:
    """Return whether the domain certainly has no participants."""
    ports = _bound_udp_ports()
    if ports is None or not is_on_this_machine_only():
        return False
    return all(domain != domain_id or place == _RESERVATION for domain, place in _places(ports))


def participants_here(domain_id: int) -> int | None:
    """Return the number of the domain's participants on this machine, None if it is unknown."""
    ports = _bound_udp_ports()
    if ports is None:
        return None
    first = _first_port(domain_id)
    return len(ports & set(range(first + _FIRST_OWN_PORT, first + _PORTS_PER_DOMAIN, 2)))


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Reserve an unused domain of this machine until the block ends, and yield its number.

    Raises:
        Refused: Every domain is in use.
    """
    while True:
        domain_id = _free_domain()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reservation:
            try:
                reservation.bind(("127.0.0.1", _first_port(domain_id) + _RESERVATION))
            except OSError:  # another process has just reserved it
                continue
            yield domain_id
            return


def _free_domain() -> int:
    """Return a random free domain; may raise Refused."""
    taken = {domain_id for domain_id, _ in _places(_bound_udp_ports() or set())}
    taken.add(int(os.environ.get("ROS_DOMAIN_ID") or 0))
    free = [domain_id for domain_id in DOMAINS if domain_id not in taken]
    if not free:
        raise Refused(
            "every ROS domain from 1 to 101 is in use on this machine", "stop one of them"
        )
    return free[int.from_bytes(os.urandom(8)) % len(free)]


def _first_port(domain_id: int) -> int:
    return _PORT_BASE + _PORTS_PER_DOMAIN * domain_id


def _places(ports: Iterable[int]) -> Iterator[tuple[int, int]]:
    """Yield (domain, offset of the port in it) for each port, also for ports of other programs."""
    return (divmod(port - _PORT_BASE, _PORTS_PER_DOMAIN) for port in ports)


def _bound_udp_ports() -> set[int] | None:
    """Return the UDP ports that are bound on this machine, or None without /proc."""
    ports: set[int] | None = None
    # Linux returns a table page by page: if a socket is closed between two pages, another one may
    # be missing (in 1 of 80 reads on a busy machine). Discovery looks some 50 times.
    for table in 4 * _TABLES:
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:  # no IPv6, or no /proc
            continue
        ports = (ports or set()) | {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    return ports
