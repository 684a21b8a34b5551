"""The socket of a view: what is refused says which option to change."""

from __future__ import annotations

import errno
import os
from socket import socket

import pytest

from robotctl.errors import Refused
from robotctl.view.listening import listening_socket


@pytest.mark.parametrize("host", ["192.0.2.1", "no-such-name.invalid", "..", "a" * 70, ""])
@pytest.mark.parametrize("port", [None, 0])
def test_a_host_that_is_not_this_computer_is_named_with_its_option(
    host: str, port: int | None
) -> None:
    with pytest.raises(Refused, match=r"cannot listen on .*--host") as caught:
        listening_socket(host, port)
    assert repr(host) in str(caught.value)
    assert "port" not in str(caught.value)


def test_no_other_process_gets_the_port_before_the_view_accepts() -> None:
    """A port that is only bound can be bound twice, and the second view would fail at `listen`."""
    with listening_socket("127.0.0.1", 0) as first, socket() as other:
        port = first.getsockname()[1]
        with pytest.raises(Refused, match=os.strerror(errno.EADDRINUSE)):
            listening_socket("127.0.0.1", port)
        other.connect(("127.0.0.1", port))
