"""The limits of the control socket's clients."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ClientLimits:
    """How much one client, and all clients together, may use of the daemon."""

    clients: int = 64
    """A further connection gets an error: the daemon is busy."""
    overflow: int = 256
    """Connections above `clients` that the daemon still reads, for one emergency stop each.

    A further one closes the oldest that is silent. Together with `clients` this is well below 1,024
    open files, the usual limit of a process.
    """
    request_s: float = 10.0
    """Time for a whole request, from the connection's start or the previous reply."""
    overflow_request_s: float = 1.0
    """The same for a connection above `clients`."""
    write_s: float = 5.0
    """Time for a client to read its reply."""
    hangup_poll_s: float = 0.1
    """Period of the check, in a call without a deadline, that the client is still connected."""


DEFAULT_LIMITS = ClientLimits()
