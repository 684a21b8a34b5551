"""The token of the lease for which the commands of a shell act."""

from __future__ import annotations

import os

from robotctl.errors import UsageError
from robotctl.paths import LEASE_VARIABLE

_LENGTHS = range(16, 65)


def own_token() -> str | None:
    """Return the token in ROBOTCTL_LEASE, None if there is none.

    Raises:
        UsageError: It cannot be one.
    """
    token = os.environ.get(LEASE_VARIABLE)
    if token and len(token) not in _LENGTHS:
        raise UsageError(f"{LEASE_VARIABLE} is not the token of a lease", f"unset {LEASE_VARIABLE}")
    return token or None
