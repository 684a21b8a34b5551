"""Who may connect: by the Host, the Origin and the token of the first request.

Any web page can open a WebSocket to this machine, also under a foreign host name (DNS rebinding).
So the Host must be an IP address or a name of this computer, the Origin must be known, and the URL
must have the token of this run, which keeps out other users of the machine, too.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Iterable, Sequence
from typing import Final
from urllib.parse import parse_qs, urlsplit

KNOWN_ORIGINS: Final = (
    "https://app.foxglove.dev",
    "https://studio.foxglove.dev",
    "file://",
    "http://localhost:8080",
    "http://127.0.0.1:8080",
)
"""The pages of Foxglove, the desktop applications, and Lichtblick as its container serves it."""

_TOKEN_BYTES: Final = 24


def new_token() -> str:
    """Return a token that cannot be guessed."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


class Admission:
    """Checks the first request of a connection."""

    def __init__(self, token: str, origins: Iterable[str] = (), host: str = "localhost") -> None:
        """Admit requests with this token from KNOWN_ORIGINS and `origins`, or without an Origin.

        `host` is one more name that a Host header may have.
        """
        self._token = token.encode()
        self._own_names = {"localhost", socket.gethostname().lower(), host.lower()}
        self._origins = {*KNOWN_ORIGINS, *origins}

    def refusal(self, target: str, hosts: Sequence[str], origins: Sequence[str]) -> str:
        """Return why a request is refused, "" if it is admitted.

        `target` is the path with the query; `hosts` and `origins` are all Host and Origin headers.
        """
        if len(hosts) != 1 or not self._is_own_host(hosts[0]):
            return "the Host header names no address of this computer"
        if len(origins) > 1 or not self._origins.issuperset(origins):
            return "pages of this origin may not connect (robotctl view --origin allows one)"
        given = parse_qs(target.partition("?")[2]).get("token", [])
        if len(given) != 1 or not hmac.compare_digest(given[0].encode(), self._token):
            return "the URL does not have the token of this run: copy it from robotctl view"
        return ""

    def _is_own_host(self, header: str) -> bool:
        """Return whether a Host header names this computer, or is an IP address."""
        try:
            host = urlsplit(f"//{header}").hostname
        except ValueError:
            return False
        if not host:
            return False
        try:
            ipaddress.ip_address(host)
        except ValueError:
            return host in self._own_names
        return True
