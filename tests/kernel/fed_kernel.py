"""A kernel with every input required and fed, on a virtual clock, and each cause provoked in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import inf, nan

from robotctl.kernel.constants import TWIST_STAMPED
from robotctl.kernel.course import PLAIN
from robotctl.kernel.fence import FenceParams
from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, ScanParams, TrackingParams
from robotctl.kernel.path import Path
from robotctl.kernel.patterns import Pattern, PatternKind, path_of
from robotctl.kernel.safety_inputs import SafetyInput, SafetyInputParams, Use
from robotctl.kernel.types import (
    ZERO,
    Cause,
    CommandListenersSeen,
    CommandPublishersSeen,
    FaultCleared,
    FaultReported,
    LifecycleChanged,
    LifecycleState,
    LoopStalled,
    Odometry,
    OdomReceived,
    SafetyInputReceived,
    ScanReceived,
)
from robotctl.testing.kernels import TICK_NS, Bench


def lap_of(kind: PatternKind, size_m: float) -> Path:
    """Return one lap of a plain pattern."""
    return path_of(Pattern(kind, size_m), PLAIN)


CLEAR = (inf,) * 64
BLOCKED = (*CLEAR[:32], 0.4, *CLEAR[33:])
AWAY = Pose(0.4, 0.0, 0.0)
"""Outside the fence, and no jump of odometry."""


def all_required() -> KernelParams:
    """Return parameters with every rule on; only the robot's tracking has no limit."""
    inputs = SafetyInputParams()
    required = {
        kind.value: replace(inputs.of(kind), use=Use.REQUIRED, timeout_s=0.5)
        for kind in SafetyInput
    }
    return replace(
        KernelParams(),
        inputs=replace(inputs, **required),  # type: ignore[arg-type]
        scan=ScanParams(use=Use.REQUIRED),
        fence=FenceParams(radius_m=0.3),
        tracking=TrackingParams(max_error_m=100.0),
        pattern=Pattern(PatternKind.SQUARE, 20.0, 0.5),
    )


class FedKernel(Bench):
    """A bench that feeds all inputs at each `turn`; tests change what is fed."""

    def __init__(self, params: KernelParams | None = None) -> None:
        super().__init__(params or all_required())
        self.values = dict.fromkeys(SafetyInput, 0.0)
        self.silent: set[object] = set()
        self.level = 1.0
        self.pose = ORIGIN
        self.second: Pose | None = None
        self.scan = CLEAR
        self.give(CommandListenersSeen(self.t_ns, 1, ()))
        self.turn(3)

    def turn(self, ticks: int = 1) -> None:
        """Feed everything and tick, again and again."""
        for _ in range(ticks):
            if "odometry" not in self.silent:
                self.odometry(self.pose)
            if self.second is not None:
                sample = Odometry(self.second, ZERO, self.t_ns)
                self.give(OdomReceived(self.t_ns, sample, source=1))
            if "scan" not in self.silent:
                self.give(ScanReceived(self.t_ns, self.scan))
            for kind, value in self.values.items():
                if kind not in self.silent:
                    self.give(SafetyInputReceived(self.t_ns, kind, value))
            self.battery(self.level)
            self.tick()


Change = Callable[[FedKernel], object]


@dataclass(frozen=True, slots=True)
class Provoked:
    """How a cause begins and ends, and which feed it changes; causes of one feed exclude others."""

    feed: str
    begin: Change
    end: Change


def reading(kind: SafetyInput, value: float) -> Provoked:
    return Provoked(
        kind.value,
        lambda fed: fed.values.update({kind: value}),
        lambda fed: fed.values.update({kind: 0.0}),
    )


def silence(feed: str, what: object) -> Provoked:
    return Provoked(feed, lambda fed: fed.silent.add(what), lambda fed: fed.silent.discard(what))


def attribute(feed: str, name: str, value: object) -> Provoked:
    before = {"level": 1.0, "pose": ORIGIN, "second": None, "scan": CLEAR}[name]
    return Provoked(
        feed, lambda fed: setattr(fed, name, value), lambda fed: setattr(fed, name, before)
    )


def report(cause: Cause) -> Provoked:
    return Provoked(
        cause.value,
        lambda fed: fed.give(FaultReported(fed.t_ns, cause, "provoked")),
        lambda fed: fed.give(FaultCleared(fed.t_ns, cause)),
    )


def listeners(count: int, *others: str) -> Provoked:
    return Provoked(
        "listeners",
        lambda fed: fed.give(CommandListenersSeen(fed.t_ns, count, others)),
        lambda fed: fed.give(CommandListenersSeen(fed.t_ns, 1, ())),
    )


def lifecycle(fed: FedKernel, state: LifecycleState) -> None:
    fed.give(LifecycleChanged(fed.t_ns, state, "test"))


def gap(fed: FedKernel) -> None:
    """Let no tick come for 0.4 s, which no other rule minds."""
    fed.t_ns += 400_000_000 - TICK_NS
    fed.tick()


PROVOKED: dict[Cause, Provoked] = {
    Cause.ESTOP_PRESSED: reading(SafetyInput.ESTOP, 1.0),
    Cause.ESTOP_SILENT: silence("joy", SafetyInput.JOY),
    Cause.BATTERY_LOW: attribute("battery", "level", 0.1),
    **{
        cause: report(cause)
        for cause in (
            Cause.TASK_DIED,
            Cause.RECORDER_FAILED,
            Cause.UNREACHABLE,
            Cause.DAEMON_ENDS,
            Cause.TOPIC_TROUBLE,
        )
    },
    Cause.NOT_ACTIVE: Provoked(
        "lifecycle",
        lambda fed: lifecycle(fed, LifecycleState.INACTIVE),
        lambda fed: lifecycle(fed, LifecycleState.ACTIVE),
    ),
    Cause.ODOMETRY_WRONG: attribute("odometry", "pose", Pose(nan, 0.0, 0.0)),
    Cause.ODOMETRY_LOST: silence("odometry", "odometry"),
    Cause.ODOMETRY_CONTRADICTED: attribute("odometry", "second", Pose(9.0, 0.0, 0.0)),
    Cause.SECOND_ODOMETRY: attribute("odometry", "second", ORIGIN),
    Cause.FENCE_LEFT: attribute("odometry", "pose", AWAY),
    Cause.OBSTACLE_NEAR: attribute("scan", "scan", BLOCKED),
    Cause.SCAN_LOST: silence("scan", "scan"),
    Cause.BUMPER_PRESSED: reading(SafetyInput.BUMPER, 1.0),
    Cause.TILTED: reading(SafetyInput.TILT, 1.0),
    Cause.BASE_FAULT: reading(SafetyInput.DIAGNOSTICS, 2.0),
    Cause.INPUT_LOST: silence("diagnostics", SafetyInput.DIAGNOSTICS),
    Cause.FOREIGN_PUBLISHER: Provoked(
        "publishers",
        lambda fed: fed.give(CommandPublishersSeen(fed.t_ns, ("/other",))),
        lambda fed: fed.give(CommandPublishersSeen(fed.t_ns, ())),
    ),
    Cause.COMMAND_UNHEARD: listeners(0),
    Cause.COMMAND_TYPES_MIXED: listeners(1, TWIST_STAMPED),
    Cause.BATTERY_UNKNOWN: attribute("battery", "level", nan),
}
"""Each cause that lasts as long as it is provoked."""

MOMENTARY: dict[Cause, Change] = {
    Cause.LOOP_STALLED: lambda fed: fed.give(LoopStalled(fed.t_ns, 0.4, 5, 0, "test")),
    Cause.TICK_OVERRUN: gap,
}
"""Causes that are over when ticks come again."""

LONGEST_TICKS = 40
"""Until the slowest of them is noticed: silence of 0.5 s."""


def in_mode(mode: Mode) -> FedKernel:
    """Return a fed kernel in this mode, once the fence has its place; in another if that fails."""
    fed = FedKernel()
    fed.request(Mode.MOVING)
    fed.turn(2)
    if mode is not Mode.MOVING:
        fed.request(mode)
        fed.turn(60)
    return fed
