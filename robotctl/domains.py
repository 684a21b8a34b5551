"""ROS domains: how far they reach, and which are in use, without joining one.

A domain in use is known by the ports that its processes bind on this machine.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from robotctl.errors import Refused

DOMAINS = range(1, 102)
"""Not 0, where everybody is who did not choose; above 101 the ports are Linux's ephemeral ones."""

_PORT_BASE, _PORTS_PER_DOMAIN = 7400, 250
"""The well-known ports of a domain (DDSI-RTPS 2.5, 9.6.2.3, Well-known Ports)."""

_FIRST_OWN_PORT = 10
"""From here on each participant has two ports of its own, the even one for discovery."""

_RESERVATION = 9
"""The place of a port between those that all participants share and those of their own."""

_TABLES = ("/proc/net/udp", "/proc/net/udp6")


def discovery_range() -> str:
    """Return how far ROS looks for others, as its environment variable has it."""
    return os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")


def is_on_this_machine_only() -> bool:
    """Whether ROS looks for nobody on other machines."""
    return discovery_range() in ("LOCALHOST", "OFF")


def is_deserted(domain_id: int) -> bool:
    """Whether nobody can be in the domain yet; False where that cannot be seen."""
    ports = _bound_udp_ports()
    if ports is None or not is_on_this_machine_only():
        return False
    return all(domain != domain_id or place == _RESERVATION for domain, place in _places(ports))


def participants_here(domain_id: int) -> int | None:
    """How many take part in the domain on this machine; None where that cannot be seen."""
    ports = _bound_udp_ports()
    if ports is None:
        return None
    first = _first_port(domain_id)
    return len(ports & set(range(first + _FIRST_OWN_PORT, first + _PORTS_PER_DOMAIN, 2)))


@contextmanager
def reserved_domain() -> Iterator[int]:
    """A domain that is in no use here, and that nobody else is given until the block ends.

    It is held by a bound port, so the system gives it back however the process ends. Raises
    Refused when all are taken.
    """
    while True:
        domain_id = _free_domain()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reservation:
            try:
                reservation.bind(("127.0.0.1", _first_port(domain_id) + _RESERVATION))
            except OSError:  # somebody was faster: it is in use now
                continue
            yield domain_id
            return


def _free_domain() -> int:
    """Chosen at random, so that two that look at the same time rarely meet. Raises Refused."""
    taken = {domain_id for domain_id, _ in _places(_bound_udp_ports() or set())}
    taken.add(int(os.environ.get("ROS_DOMAIN_ID") or 0))
    free = [domain_id for domain_id in DOMAINS if domain_id not in taken]
    if not free:
        raise Refused("every ROS domain from 1 to 101 is in use on this machine", "stop one")
    return free[int.from_bytes(os.urandom(8)) % len(free)]


def _first_port(domain_id: int) -> int:
    return _PORT_BASE + _PORTS_PER_DOMAIN * domain_id


def _places(ports: Iterable[int]) -> Iterator[tuple[int, int]]:
    """The domain of each port, and its place there; those of other programs among them."""
    return (divmod(port - _PORT_BASE, _PORTS_PER_DOMAIN) for port in ports)


def _bound_udp_ports() -> set[int] | None:
    """The ports that are bound on this machine, None without a /proc that tells them."""
    ports: set[int] | None = None
    for table in _TABLES:
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:  # no IPv6, or no /proc
            continue
        ports = (ports or set()) | {int(line.split()[1].rpartition(":")[2], 16) for line in lines}
    return ports
