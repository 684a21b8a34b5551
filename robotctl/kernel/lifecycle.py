"""The lifecycle of the node that gates motion, as ROS defines it for managed nodes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class LifecycleState(Enum):
    """The primary states of a managed node by their labels; motion starts in ACTIVE only."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


@dataclass(frozen=True, slots=True)
class LifecycleChanged:
    """The node that gates motion is in another state."""

    t_ns: int
    state: LifecycleState
    source: str
