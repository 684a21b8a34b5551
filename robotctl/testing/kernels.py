"""Kernels in every mode, and simulated drives, without clock, ROS and processes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.course import PLAIN, Course
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
from robotctl.sim import Robot, SimParams

TICK_NS = 20_000_000

MOST_TURNS = 1000
"""After this number of iterations, `while_moving` fails."""


class Bench:
    """A kernel under test with a virtual clock, and all its events and effects so far."""

    def __init__(self, params: KernelParams | None = None, state: State | None = None) -> None:
        self.kernel = Kernel(params or KernelParams(), state)
        self.t_ns = NS_PER_S
        self.effects: list[Effect] = []
        self.events: list[Event] = []
        self._requests = 0

    @property
    def state(self) -> State:
        """The state of the kernel."""
        return self.kernel.state

    def give(self, event: Event) -> tuple[Effect, ...]:
        """Feed the kernel an event and return its effects."""
        self.events.append(event)
        effects = self.kernel.step(event)
        self.effects += effects
        return effects

    def odometry(self, pose: Pose = ORIGIN, stamp_ns: int | None = None) -> tuple[Effect, ...]:
        """Feed the kernel odometry that arrives now, stamped now unless `stamp_ns` is given."""
        stamp_ns = self.t_ns if stamp_ns is None else stamp_ns
        return self.give(OdomReceived(self.t_ns, Odometry(pose, ZERO, stamp_ns)))

    def battery(self, level: float) -> tuple[Effect, ...]:
        """Feed the kernel a battery level at the present time."""
        return self.give(BatteryReceived(self.t_ns, level))

    def tick(self) -> tuple[Effect, ...]:
        """Advance the time by one tick, and feed the kernel that tick."""
        self.t_ns += TICK_NS
        return self.give(Tick(self.t_ns))

    def run(self, ticks: int) -> None:
        """Run `ticks` control ticks with a healthy robot that stands still."""
        for _ in range(ticks):
            odometry = self.state.health.odometry
            self.odometry(ORIGIN if odometry is None else odometry.pose)
            self.battery(1.0)
            self.tick()

    def new_request_id(self) -> int:
        """Return a new request id."""
        self._requests += 1
        return self._requests

    def request(self, requested: int) -> tuple[Effect, ...]:
        """Request the mode with the number `requested`, and return the kernel's effects."""
        return self.give(ModeRequested(self.t_ns, self.new_request_id(), requested, "test"))

    def drive(
        self,
        pattern: Pattern | None = None,
        laps: int = 0,
        *,
        replacing: bool = False,
        course: Course = PLAIN,
    ) -> tuple[Effect, ...]:
        """Request a drive of `pattern`, and return the kernel's effects."""
        number, pattern = self.new_request_id(), pattern or Pattern()
        event = DriveRequested(self.t_ns, number, pattern, laps, replacing, "test", course=course)
        return self.give(event)

    @property
    def replies(self) -> list[Reply]:
        """All replies of the kernel to requests so far."""
        return [effect for effect in self.effects if isinstance(effect, Reply)]

    @property
    def commands(self) -> list[Twist]:
        """The commands of all effects so far, in their order."""
        return [effect.twist for effect in self.effects if isinstance(effect, PublishTwist)]


def ready(params: KernelParams | None = None) -> Bench:
    """Return a test bench (`Bench`) in mode IDLE that fulfils all conditions to start moving."""
    bench = Bench(params)
    bench.run(3)
    return bench


def moving(params: KernelParams | None = None, ticks: int = 10) -> Bench:
    """Return a test bench (`Bench`) that has been in mode MOVING for `ticks` control ticks."""
    bench = ready(params)
    bench.request(Mode.MOVING)
    bench.run(ticks)
    assert bench.state.mode is Mode.MOVING
    return bench


def stopping() -> Bench:
    """Return a test bench (`Bench`) in mode MOVING whose robot is ramping down to zero velocity."""
    bench = moving()
    bench.request(Mode.IDLE)
    assert bench.state.phase is Phase.STOPPING
    return bench


def in_mode(mode: Mode) -> Bench:
    """Return a test bench (`Bench`) with a healthy robot, whose `mode` was entered by a request."""
    if mode is Mode.MOVING:
        return moving()
    bench = ready()
    if mode is not Mode.IDLE:
        bench.request(mode)
    return bench


def reset(bench: Bench) -> bool:
    """Request a reset; return whether it was accepted."""
    bench.give(ResetRequested(bench.t_ns, bench.new_request_id(), "test"))
    return bench.replies[-1].ok


def start(bench: Bench) -> str:
    """Request MOVING; return the text of a refusal, else ""."""
    bench.request(Mode.MOVING)
    return "" if bench.replies[-1].ok else bench.replies[-1].message


def stopped_by(bench: Bench, cause: Cause, mode: Mode) -> bool:
    """Return whether the robot stands in `mode` because of `cause`."""
    state = bench.state
    return state.mode is mode and state.cause is cause and state.command == ZERO


def while_moving(bench: Bench) -> Iterator[None]:
    """Yield repeatedly while the robot is MOVING; the loop's body must step the kernel.

    Raises:
        AssertionError: The robot is still MOVING after MOST_TURNS iterations.
    """
    for _ in range(MOST_TURNS):
        if bench.state.mode is not Mode.MOVING:
            return
        yield
    raise AssertionError(f"still MOVING: {bench.state}")


@dataclass(frozen=True, slots=True)
class Driven:
    """The result of a simulated drive; `pose` is the last pose that odometry reported."""

    ended: DriveEnded
    duration_s: float
    events: tuple[Event, ...]
    commands: tuple[Twist, ...]
    pose: Pose


def drive_simulated(
    pattern: Pattern,
    *,
    laps: int = 1,
    rate_hz: float = 50.0,
    sim: SimParams | None = None,
    course: Course = PLAIN,
    params: KernelParams | None = None,
) -> Driven:
    """Drive a simulated robot until the drive ends; `rate_hz` is the rate of the ticks.

    Raises:
        AssertionError: The drive does not end within 200 simulated seconds.
    """
    bench = Bench(replace(params or KernelParams(), rate_hz=rate_hz))
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
                events, commands = tuple(bench.events), tuple(bench.commands)
                return Driven(effect, seconds, events, commands, robot.odometry)
        if not begin_ns and t_ns >= 100_000_000:
            begin_ns = t_ns
            bench.drive(pattern, laps, course=course)
            assert bench.replies[-1].ok, bench.replies[-1]
    raise AssertionError(f"the drive did not end: {bench.state}")


def _schedule(rate_hz: float, odometry_rate_hz: float) -> Iterator[tuple[str, int]]:
    """Yield kind and time [ns] of each input of 200 simulated seconds."""
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
