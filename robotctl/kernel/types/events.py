"""The events: everything that `Kernel.step` handles, with leases and lifecycle states.

Every event carries its steady time `t_ns` in nanoseconds: the kernel has no clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from robotctl.kernel.command_types import TWIST
from robotctl.kernel.course import PLAIN, Course
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.safety_inputs import SafetyInput
from robotctl.kernel.types.values import Cause, Odometry, Twist


@dataclass(frozen=True, slots=True)
class Lease:
    """The client that holds the lease, its name as `source`, and why it holds the lease."""

    client: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LeaseRequested:
    """A request to get the lease (`take`) or to release it; it gets one `Reply`."""

    t_ns: int
    request_id: int
    take: bool
    client: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class LeaseLost:
    """The client that holds the lease has disconnected or is silent; `how` says which."""

    t_ns: int
    client: int
    how: str = "its connection closed"


class MotionRequest(Protocol):
    """A request from a client; `client` is 0 for a client without an identity."""

    @property
    def request_id(self) -> int:
        """The id of the request, which the reply carries as well."""

    @property
    def client(self) -> int:
        """The number of the client."""

    @property
    def source(self) -> str:
        """The name of the client."""


@dataclass(frozen=True, slots=True)
class ParameterRequested:
    """A request to change the parameter `key` from the text `old` to the text `new`.

    It gets one `Reply`. The text of a float is its repr. The kernel checks the values of its own
    parameters; the daemon has already checked all others.
    """

    t_ns: int
    request_id: int
    key: str
    old: str
    new: str
    source: str


@dataclass(frozen=True, slots=True)
class ParameterChanged:
    """A parameter has a new value from now on."""

    key: str
    old: str
    new: str
    source: str


class LifecycleState(Enum):
    """The primary states of a managed node by their labels; motion starts in ACTIVE only."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


@dataclass(frozen=True, slots=True)
class LifecycleChanged:
    """The lifecycle node `source`, which gates motion, has changed to `state`."""

    t_ns: int
    state: LifecycleState
    source: str


@dataclass(frozen=True, slots=True)
class Tick:
    """The next command is due; `missed` ticks just before this tick were skipped."""

    t_ns: int
    missed: int = 0


@dataclass(frozen=True, slots=True)
class OdomReceived:
    """A sample of odometry arrived; its values may be anything, even NaN.

    `source` is the number of the publisher (see `OdometrySourceFound`), 0 if unknown. `sequence`
    is the number that the publisher gave the sample.
    """

    t_ns: int
    odometry: Odometry
    source: int = 0
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class OdometrySourceFound:
    """A publisher of odometry sent its first sample, or its node name became known.

    `source` is its number from now on, `gid` its DDS identity, `name` its node name or "".
    `frame_id` is the frame that its samples name, "" if unknown; each change causes a new event.
    """

    t_ns: int
    source: int
    gid: str
    name: str
    frame_id: str = ""


@dataclass(frozen=True, slots=True)
class BatteryReceived:
    """The battery level as the gauge reports it; `battery.scale` says which value is full.

    `publisher` is the DDS identity of the gauge, `sequence` the number that it gave the message.
    """

    t_ns: int
    level: float
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class SafetyInputReceived:
    """A message of a safety input; `detail` is the sender's text, if it has one.

    Of many equal messages, only some become events: enough to show that the input is not silent.
    `publisher` and `sequence` are as in `BatteryReceived`.
    """

    t_ns: int
    kind: SafetyInput
    value: float
    detail: str = ""
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class ScanReceived:
    """A laser scan: the nearest range in each sector [m], counter-clockwise from straight behind.

    A range is inf if the sector is empty; `sectors` is () if the message is unreadable. `publisher`
    and `sequence` are as in `BatteryReceived`.
    """

    t_ns: int
    sectors: tuple[float, ...]
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class ModeRequested:
    """A request for a mode by its number, valid or not; it gets one `Reply`.

    `client` is the client's number, as in `Lease`, 0 without an identity. `reason` is the client's
    text. `remote` means that the request may come from another host.
    """

    t_ns: int
    request_id: int
    requested: int
    source: str
    client: int = 0
    reason: str = ""
    remote: bool = False


@dataclass(frozen=True, slots=True)
class ResetRequested:
    """A request to leave EMERGENCY_STOP or ERROR; it gets one `Reply`."""

    t_ns: int
    request_id: int
    source: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class DriveRequested:
    """A request to drive `laps` laps (0: until stopped) of a pattern; it gets one `Reply`.

    `client`, `reason` and `remote` are as in `ModeRequested`. With `replace`, the drive may replace
    a running drive. `course` may replace the pattern by waypoints or a held velocity.
    """

    t_ns: int
    request_id: int
    pattern: Pattern
    laps: int
    replace: bool
    source: str
    client: int = 0
    reason: str = ""
    course: Course = PLAIN
    remote: bool = False


@dataclass(frozen=True, slots=True)
class HoldReceived:
    """A hold-to-run client repeats its request, with the velocity it wants now (NaN is possible).

    `hold` is the id of the drive's `DriveRequested`; `client` is as in `ModeRequested`.
    """

    t_ns: int
    hold: int
    twist: Twist
    client: int = 0


@dataclass(frozen=True, slots=True)
class CommandPublishersSeen:
    """The nodes, except robotctl's own, that have a publisher on the command topic now."""

    t_ns: int
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ForeignCommandHeard:
    """Another node published a velocity command."""

    t_ns: int
    publisher: str


@dataclass(frozen=True, slots=True)
class CommandListenersSeen:
    """The number of subscriptions to the command topic with the type that robotctl sends.

    `type_name` is the sent type; `other_types` are the types of all other subscriptions.
    """

    t_ns: int
    count: int
    other_types: tuple[str, ...]
    type_name: str = TWIST


@dataclass(frozen=True, slots=True)
class GuardedCommandReceived:
    """Another node wants this velocity in a guarded motion; the values are unchecked, even NaN.

    `publisher` and `sequence` are as in `BatteryReceived`.
    """

    t_ns: int
    twist: Twist
    publisher: str = ""
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class LoopStalled:
    """The control loop stalled for `stalled_s` seconds, and the watchdog sent zeros meanwhile.

    The watchdog sent `zeros` zero commands on its own, and `withheld` commands of the kernel were
    not sent. `detail` says what blocked the loop.
    """

    t_ns: int
    stalled_s: float
    zeros: int
    withheld: int
    detail: str


@dataclass(frozen=True, slots=True)
class FaultReported:
    """A part of the daemon failed; `detail` says how."""

    t_ns: int
    cause: Cause
    detail: str


@dataclass(frozen=True, slots=True)
class FaultCleared:
    """A part of the daemon works again."""

    t_ns: int
    cause: Cause


Event = (
    Tick
    | OdomReceived
    | BatteryReceived
    | SafetyInputReceived
    | ScanReceived
    | LifecycleChanged
    | ModeRequested
    | ResetRequested
    | DriveRequested
    | ParameterRequested
    | LeaseRequested
    | LeaseLost
    | GuardedCommandReceived
    | HoldReceived
    | OdometrySourceFound
    | CommandPublishersSeen
    | ForeignCommandHeard
    | CommandListenersSeen
    | LoopStalled
    | FaultReported
    | FaultCleared
)
"""Everything that `Kernel.step` accepts."""
