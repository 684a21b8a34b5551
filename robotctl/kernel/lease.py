"""The lease: the right of one client to start and steer motion. Anybody may stop the robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Lease:
    """The holder by its number and its name, and why it took the lease."""

    client: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LeaseRequested:
    """A client takes the lease, or releases it; it gets one `Reply`."""

    t_ns: int
    request_id: int
    take: bool
    client: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LeaseLost:
    """A holder is gone; `how` says how that was noticed."""

    t_ns: int
    client: int
    how: str = "its connection closed"


class MotionRequest(Protocol):
    """A request that starts or steers motion; `client` is 0 for one without an identity."""

    @property
    def request_id(self) -> int:
        """The id that its reply carries."""

    @property
    def client(self) -> int:
        """The number of the client."""

    @property
    def source(self) -> str:
        """The name of the client."""
