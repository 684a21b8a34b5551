"""Kernels in every mode, and a simulated world around one: no clock, no bus, no process."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from robotctl.kernel.geometry import ORIGIN, Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    Cause,
    DriveEnded,
    DriveRequested,
    Effect,
    Event,
    ModeRequested,
    Odometry,
    OdomReceived,
    Phase,
    PublishTwist,
    Reply,
    ResetRequested,
    Tick,
    Twist,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.sim.robot import Robot, SimParams

TICK_NS = 20_000_000


class Bench:
    """A kernel, and the steady time at which it gets what a test gives it."""

    def __init__(self, params: KernelParams | None = None, state: State | None = None) -> None:
        self.kernel = Kernel(params or KernelParams(), state)
        self.t_ns = NS_PER_S
        self.effects: list[Effect] = []
        self.events: list[Event] = []
        self._requests = 0

    @property
    def state(self) -> State:
        """What the kernel remembers."""
        return self.kernel.state

    def give(self, event: Event) -> tuple[Effect, ...]:
        """Take one step."""
        self.events.append(event)
        effects = self.kernel.step(event)
        self.effects += effects
        return effects

    def odometry(self, pose: Pose = ORIGIN, stamp_ns: int | None = None) -> tuple[Effect, ...]:
        """Receive odometry now."""
        stamp_ns = self.t_ns if stamp_ns is None else stamp_ns
        return self.give(OdomReceived(self.t_ns, Odometry(pose, ZERO, stamp_ns)))

    def battery(self, level: float) -> tuple[Effect, ...]:
        """Receive a battery level now."""
        return self.give(BatteryReceived(self.t_ns, level))

    def tick(self) -> tuple[Effect, ...]:
        """Let a tick pass."""
        self.t_ns += TICK_NS
        return self.give(Tick(self.t_ns))

    def run(self, ticks: int) -> None:
        """Let ticks pass with a robot that does not move, and healthy otherwise."""
        for _ in range(ticks):
            odometry = self.state.health.odometry
            self.odometry(ORIGIN if odometry is None else odometry.pose)
            self.battery(1.0)
            self.tick()

    def new_request_id(self) -> int:
        """Return a number that no request had."""
        self._requests += 1
        return self._requests

    def request(self, requested: int) -> tuple[Effect, ...]:
        """Ask for a mode."""
        return self.give(ModeRequested(self.t_ns, self.new_request_id(), requested, "test"))

    def drive(
        self, pattern: Pattern | None = None, laps: int = 0, *, replacing: bool = False
    ) -> tuple[Effect, ...]:
        """Ask for a drive."""
        return self.give(
            DriveRequested(
                self.t_ns, self.new_request_id(), pattern or Pattern(), laps, replacing, "test"
            )
        )

    @property
    def replies(self) -> list[Reply]:
        """Every reply so far."""
        return [effect for effect in self.effects if isinstance(effect, Reply)]

    @property
    def commands(self) -> list[Twist]:
        """Every command so far."""
        return [effect.twist for effect in self.effects if isinstance(effect, PublishTwist)]


def ready(params: KernelParams | None = None) -> Bench:
    """Return a kernel in IDLE whose start conditions hold."""
    bench = Bench(params)
    bench.run(3)
    return bench


def moving(params: KernelParams | None = None, ticks: int = 10) -> Bench:
    """Return a kernel that has been MOVING for some ticks."""
    bench = ready(params)
    bench.request(Mode.MOVING)
    bench.run(ticks)
    assert bench.state.mode is Mode.MOVING
    return bench


def stopping() -> Bench:
    """Return a kernel that is MOVING, and ramps down because somebody asked for IDLE."""
    bench = moving()
    bench.request(Mode.IDLE)
    assert bench.state.phase is Phase.STOPPING
    return bench


def in_mode(mode: Mode) -> Bench:
    """Return a healthy kernel that a request brought into `mode`."""
    if mode is Mode.MOVING:
        return moving()
    bench = ready()
    if mode is not Mode.IDLE:
        bench.request(mode)
    return bench


def reset(bench: Bench) -> bool:
    """Ask for a reset; return whether it was granted."""
    bench.give(ResetRequested(bench.t_ns, bench.new_request_id(), "test"))
    return bench.replies[-1].ok


def start(bench: Bench) -> str:
    """Ask for MOVING; return the refusal, "" where there is none."""
    bench.request(Mode.MOVING)
    return "" if bench.replies[-1].ok else bench.replies[-1].message


def stopped_by(bench: Bench, cause: Cause, mode: Mode) -> bool:
    """Say whether the robot stands in `mode` for that cause."""
    state = bench.state
    return state.mode is mode and state.cause is cause and state.command == ZERO


def while_moving(bench: Bench, turns: int = 1000) -> Iterator[None]:
    """Yield as long as the robot is MOVING; AssertionError if it never stops."""
    for _ in range(turns):
        if bench.state.mode is not Mode.MOVING:
            return
        yield
    raise AssertionError(f"still MOVING: {bench.state}")


@dataclass(frozen=True, slots=True)
class Driven:
    """How a simulated drive went: its end, how long it took, and all that went in and out."""

    ended: DriveEnded
    duration_s: float
    events: tuple[Event, ...]
    commands: tuple[Twist, ...]


def drive_simulated(
    pattern: Pattern, *, laps: int = 1, rate_hz: float = 50.0, sim: SimParams | None = None
) -> Driven:
    """Drive a simulated robot until the drive ends; AssertionError if it does not within 200 s."""
    bench = Bench(replace(KernelParams(), rate_hz=rate_hz))
    sim = sim or SimParams()
    robot = Robot(sim)
    begin_ns = 0
    for kind, t_ns in _schedule(rate_hz, sim.odometry_rate_hz):
        bench.t_ns = t_ns
        if kind == "odometry":
            robot.advance(1.0 / sim.odometry_rate_hz)
            measured = Odometry(robot.odometry, robot.measured, t_ns)
            effects = bench.give(OdomReceived(t_ns, measured))
        elif kind == "battery":
            effects = bench.battery(robot.battery)
        else:
            effects = bench.give(Tick(t_ns))
        for effect in effects:
            if isinstance(effect, PublishTwist):
                robot.command(effect.twist)
            elif isinstance(effect, DriveEnded):
                seconds = (t_ns - begin_ns) / NS_PER_S
                return Driven(effect, seconds, tuple(bench.events), tuple(bench.commands))
        if not begin_ns and t_ns >= 100_000_000:
            begin_ns = t_ns
            bench.drive(pattern, laps)
            assert bench.replies[-1].ok, bench.replies[-1]
    raise AssertionError(f"the drive did not end: {bench.state}")


def _schedule(rate_hz: float, odometry_rate_hz: float) -> Iterator[tuple[str, int]]:
    """Yield what happens when, for 200 s: ticks come 1 ms after the odometry of their moment."""
    due_ns = {"odometry": 0, "battery": 500_000, "tick": 1_000_000}
    period_ns = {
        "odometry": round(NS_PER_S / odometry_rate_hz),
        "battery": NS_PER_S,
        "tick": round(NS_PER_S / rate_hz),
    }
    while True:
        kind = min(due_ns, key=due_ns.__getitem__)
        t_ns = due_ns[kind]
        if t_ns > 200_000_000_000:
            return
        yield kind, t_ns
        due_ns[kind] += period_ns[kind]
