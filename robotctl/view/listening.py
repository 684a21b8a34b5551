"""The socket on which a view listens."""

from __future__ import annotations

import socket
from typing import Final

from robotctl.errors import Refused

DEFAULT_PORT: Final = 8765
"""The port that Foxglove proposes."""


def listening_socket(host: str, port: int | None) -> socket.socket:
    """Return a bound socket; None is DEFAULT_PORT, or a free port where that is taken.

    Raises:
        Refused: The address cannot be listened on.
    """
    try:
        try:
            return _bound(host, DEFAULT_PORT if port is None else port)
        except OSError:
            if port is not None:
                raise
            return _bound(host, 0)
    except OSError as error:
        where = f"{host} port {DEFAULT_PORT if port is None else port}"
        raise Refused(
            f"the view cannot listen on {where} ({error.strerror or error})",
            "choose another --port, or leave it out for a free one",
        ) from error


def _bound(host: str, port: int) -> socket.socket:
    """Return a socket that is bound to an address.

    Raises:
        OSError: The address cannot be bound.
    """
    family, kind, protocol, _, address = socket.getaddrinfo(
        host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    sock = socket.socket(family, kind, protocol)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
    except BaseException:
        sock.close()
        raise
    return sock
