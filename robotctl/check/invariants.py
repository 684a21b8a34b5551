"""The invariants that must hold in every journal, and the violations that a check collects.

The checks never compare wall-clock times.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import assert_never

from robotctl.kernel.codec import Snapshot
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.modes import Mode
from robotctl.kernel.parameter_keys import kernel_leaves, with_text
from robotctl.kernel.params import KernelParams
from robotctl.kernel.ranges import Change
from robotctl.kernel.types import (
    ZERO,
    CommandPublishersSeen,
    DriveEnded,
    DriveRequested,
    Effect,
    Event,
    ForeignCommandHeard,
    LatchEmergencyStop,
    LeaseRequested,
    LoopStalled,
    ModeChanged,
    ModeRequested,
    OdomReceived,
    ParameterChanged,
    ParameterRequested,
    PublishTwist,
    ReleaseEmergencyStop,
    Reply,
    ResetRequested,
    Tick,
    Twist,
)

MAX_VIOLATIONS = 20
"""The number of kept violations; all are counted."""

ROUNDING = 1e-9
"""The tolerance for the change between two commands."""

_REQUESTS = (ModeRequested, ResetRequested, DriveRequested, ParameterRequested, LeaseRequested)


@dataclass(frozen=True, slots=True)
class Violation:
    """A violated invariant: number and steady time [ns] of the journal entry, and a sentence."""

    seq: int
    t_ns: int
    text: str


class Invariants:
    """Checks the steps of a journal, from a snapshot on, and collects the `violations`."""

    def __init__(self) -> None:
        self.violations: list[Violation] = []
        self.count = 0
        self.mode: Mode | None = None
        self.foreign: set[str] = set()
        """The names of other nodes that published the command."""

        self._params = KernelParams()
        self._command = ZERO
        self._tick_t_ns: int | None = None
        self._open_requests: set[int] = set()
        self._latched = False
        self._at = (0, 0)

    def stop(self) -> None:
        """Stop the checks until the next snapshot."""
        self.mode = None

    def snapshot(self, snapshot: Snapshot) -> None:
        """Continue the checks from the state in a snapshot."""
        state = snapshot.state
        self._params = snapshot.params
        self.mode, self._command, self._tick_t_ns = state.mode, state.command, state.tick_t_ns
        self._open_requests = set(state.waiting)
        self._latched = state.mode is Mode.EMERGENCY_STOP
        self.foreign.update(state.health.foreign_publishers)
        if state.health.command_topic.foreign_t_ns is not None:
            self.foreign.add(state.health.command_topic.foreign_by)

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...]) -> None:
        """Check one event and its effects; `seq` is the number of the event's entry."""
        if self.mode is None or (not effects and isinstance(event, OdomReceived)):
            return
        self._at = seq, event.t_ns
        if isinstance(event, CommandPublishersSeen):
            self.foreign.update(event.names)
        elif isinstance(event, ForeignCommandHeard):
            self.foreign.add(event.publisher)
        elif isinstance(event, _REQUESTS):
            self._open_requests.add(event.request_id)
        elif isinstance(event, LoopStalled):
            self._command, self._tick_t_ns = ZERO, event.t_ns
        for effect in effects:
            match effect:
                case PublishTwist():
                    self._check_command(event, effect.twist)
                case ModeChanged():
                    self._change_mode(event, effect)
                case LatchEmergencyStop():
                    self._latched = True
                case ReleaseEmergencyStop():
                    self._latched = False
                case Reply():
                    self._check_reply(effect)
                case ParameterChanged():
                    self._change_parameter(effect)
                case DriveEnded():
                    pass  # a report: no invariant depends on it
                case _:
                    assert_never(effect)
        if self._latched is not (self.mode is Mode.EMERGENCY_STOP):
            latched = "latched" if self._latched else "not latched"
            self.violate(f"the mode is {self.mode.name}, and the emergency stop is {latched}")
            self._latched = not self._latched
        if isinstance(event, Tick):
            self._tick_t_ns = event.t_ns

    def end(self, waiting: tuple[int, ...]) -> None:
        """Check that each request got a reply; those in `waiting` (ids) may still be open."""
        for request_id in sorted(self._open_requests.difference(waiting)):
            self.violate(f"request {request_id} has no reply")

    def violate(self, text: str, at: tuple[int, int] | None = None) -> None:
        """Count and keep a violation; `at` is (seq, t_ns) of its entry, None for the last entry."""
        self.count += 1
        if len(self.violations) < MAX_VIOLATIONS:
            self.violations.append(Violation(*(at or self._at), text))

    def _check_command(self, event: Event, twist: Twist) -> None:
        limits, previous = self._params.limits, self._command
        self._command = twist
        if not (twist.linear or twist.angular):
            return
        if self.mode is not None and self.mode is not Mode.MOVING:
            self.violate(f"a command of {shown(twist)} in {self.mode.name}")
        linear, angular = abs(twist.linear), abs(twist.angular)
        if not (linear <= limits.linear_mps and angular <= limits.angular_rps):  # also nan
            self.violate(
                f"a command of {shown(twist)}, "
                f"beyond {limits.linear_mps:g} m/s, {limits.angular_rps:g} rad/s"
            )
        elif isinstance(event, Tick) and self._tick_t_ns is not None:
            dt_s = (event.t_ns - self._tick_t_ns) / NS_PER_S
            self._check_change(previous, twist, min(max(dt_s, 0.0), 2.0 / self._params.rate_hz))

    def _check_change(self, previous: Twist, twist: Twist, dt_s: float) -> None:
        limits = self._params.limits
        linear, angular = twist.linear - previous.linear, twist.angular - previous.angular
        if (
            abs(linear) > limits.linear_accel_mps2 * dt_s + ROUNDING
            or abs(angular) > limits.angular_accel_rps2 * dt_s + ROUNDING
        ):
            self.violate(
                f"the command went from {shown(previous)} to {shown(twist)} within {dt_s:.3f} s, "
                f"beyond {limits.linear_accel_mps2:g} m/s^2, {limits.angular_accel_rps2:g} rad/s^2"
            )

    def _change_parameter(self, change: ParameterChanged) -> None:
        leaf = kernel_leaves().get(change.key)
        if self.mode is Mode.MOVING and not (
            leaf and leaf.declared.metadata["change"] is Change.ANY_TIME
        ):
            self.violate(f"{change.key} changed while MOVING")
        if leaf is not None:
            try:
                self._params = with_text(self._params, change.key, change.new)
            except ValueError as error:
                self.violate(f"a change to a value that is not allowed: {error}")

    def _change_mode(self, event: Event, change: ModeChanged) -> None:
        if change.previous is not self.mode:
            mode = self.mode.name if self.mode is not None else "unknown"
            self.violate(f"a change from {change.previous.name}, while the mode was {mode}")
        if change.previous is Mode.EMERGENCY_STOP:
            if change.mode is not Mode.IDLE:
                self.violate(f"EMERGENCY_STOP was left to {change.mode.name}, not to IDLE")
            if not isinstance(event, ModeRequested | ResetRequested):
                self.violate(f"EMERGENCY_STOP was left by a {type(event).__name__}, not by a reset")
        self.mode = change.mode

    def _check_reply(self, reply: Reply) -> None:
        if reply.request_id not in self._open_requests:
            self.violate(f"a reply to request {reply.request_id}, which is not open")
        self._open_requests.discard(reply.request_id)
        if self.mode is not None and reply.mode is not self.mode:
            said, mode = reply.mode.name, self.mode.name
            self.violate(f"the reply to request {reply.request_id} says {said} in {mode}")


def unbalanced(ledger: Mapping[str, Mapping[str, int]], *, finished: bool) -> Iterator[str]:
    """Yield a sentence for each topic of a loss ledger whose counts do not add up.

    If `finished`, received must equal written + dropped; otherwise, it may be larger.
    """
    for topic, counts in ledger.items():
        received, written, dropped = (counts.get(n, 0) for n in ("received", "written", "dropped"))
        accounted = written + dropped
        if received < accounted or (finished and received != accounted):
            yield (
                f"{topic}: {received} messages received, but {written} written "
                f"and {dropped} dropped"
            )


def shown(twist: Twist) -> str:
    """Return the text of a velocity."""
    return f"{twist.linear:.6g} m/s, {twist.angular:.6g} rad/s"
