"""The socket on which a view listens."""

from __future__ import annotations

import errno
import os
import socket
from typing import Any, Final

from robotctl.errors import Refused

DEFAULT_PORT: Final = 8765
"""The port that Foxglove proposes."""

_Address = tuple[socket.AddressFamily, tuple[Any, ...]]
"""Family, and the address as `bind` takes it, with any port."""


def listening_socket(host: str, port: int | None) -> socket.socket:
    """Return a socket that listens; None is DEFAULT_PORT, or a free port where that is taken.

    Raises:
        Refused: The address cannot be listened on.
    """
    address = _address_of(host)
    try:
        try:
            return _listening(address, DEFAULT_PORT if port is None else port)
        except OSError:
            if port is not None:
                raise
            return _listening(address, 0)
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise _no_host(host, os.strerror(error.errno)) from error
        where = f"{host} port {DEFAULT_PORT if port is None else port}"
        raise Refused(
            f"the view cannot listen on {where} ({error.strerror or error})",
            "choose another --port, or leave it out for a free one",
        ) from error


def _address_of(host: str) -> _Address:
    """Return family and address of a host.

    Raises:
        Refused: It has none.
    """
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except OSError as error:
        raise _no_host(host, error.strerror or str(error)) from error
    except UnicodeError as error:  # a label of the name is empty or too long
        raise _no_host(host, "it cannot be a name") from error
    family, _, _, _, address = found[0]
    return family, address


def _listening(address: _Address, port: int) -> socket.socket:
    """Return a socket that listens on a port of an address: no other process gets it from now on.

    Raises:
        OSError: It cannot be listened on.
    """
    family, (host, _, *rest) = address
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind((host, port, *rest))
        sock.listen()
    except BaseException:
        sock.close()
        raise
    return sock


def _no_host(host: str, reason: str) -> Refused:
    """Return the error for a host on which no port can be listened on."""
    return Refused(
        f"the view cannot listen on {host!r} ({reason})",
        "give an address of this computer as --host, or leave it out for 127.0.0.1",
    )
