"""The common parameters of requests: source, reason and lease."""

from __future__ import annotations

import os
import re

from robotctl.base.errors import UsageError
from robotctl.base.paths import LEASE_VARIABLE
from robotctl.ipc.protocol import MAX_REASON, REASON_PATTERN

_LENGTHS = range(16, 65)


def own_token() -> str | None:
    """Return the lease token in ROBOTCTL_LEASE, or None if it is not set.

    Raises:
        UsageError: The token has a wrong length.
    """
    token = os.environ.get(LEASE_VARIABLE)
    if token and len(token) not in _LENGTHS:
        raise UsageError(f"{LEASE_VARIABLE} is not the token of a lease", f"unset {LEASE_VARIABLE}")
    return token or None


def request_source(command: str) -> str:
    """Return the name of the requester, for the daemon's log and journal."""
    return f"robotctl {command} (uid {os.getuid()}, pid {os.getpid()})"


def asked_by(command: str, reason: str = "") -> dict[str, str]:
    """Return the parameters of a request that name its source and, if given, its reason.

    Raises:
        UsageError: The reason is not allowed.
    """
    params = {"source": request_source(command)}
    return {**params, "reason": checked_reason(reason)} if reason else params


def checked_reason(reason: str) -> str:
    """Return the reason if a daemon accepts it.

    Raises:
        UsageError: The reason is too long, or has control characters.
    """
    if len(reason) > MAX_REASON:
        problem = f"--reason of {len(reason)} characters"
    elif not re.match(REASON_PATTERN, reason):
        problem = "--reason with control characters"
    else:
        return reason
    raise UsageError(problem, f"use at most {MAX_REASON} characters on one line")


def lease_of_shell() -> dict[str, str]:
    """Return the parameter `lease` of a request, from ROBOTCTL_LEASE; {} if that is not set.

    Raises:
        UsageError: The token has a wrong length.
    """
    token = own_token()
    return {"lease": token} if token else {}
