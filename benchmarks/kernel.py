"""What one `Kernel.step` costs [us], by mode and kind of event.

    python benchmarks/kernel.py

Each round takes the same steps through a fresh kernel and is timed with the CPU clock of the
process; the median of the rounds is shown with their spread, and the minimum, which is what the
promise of 15 us a step is held against: on a shared machine the rest is other people's work.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from statistics import median

from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.types import (
    ZERO,
    BatteryReceived,
    CommandPublishersSeen,
    DriveRequested,
    Event,
    ModeRequested,
    Odometry,
    OdomReceived,
    PublishTwist,
    Tick,
)
from robotctl.sim.robot import Robot, SimParams

STEPS = 4_000
TARGET_US = 15.0
PERIOD_NS = 20_000_000


@dataclass(frozen=True, slots=True)
class Case:
    """One line of the table: a kernel to begin with, and the events to feed it."""

    name: str
    kernel: Callable[[], Kernel]
    events: tuple[Event, ...]


def standing() -> Kernel:
    """Return a kernel in IDLE whose start conditions hold."""
    kernel = Kernel(KernelParams())
    kernel.step(Tick(0))
    kernel.step(BatteryReceived(0, 1.0))
    kernel.step(OdomReceived(0, Odometry(Pose(), ZERO, 0)))
    return kernel


def driving(kind: PatternKind) -> Callable[[], Kernel]:
    """Return what makes a kernel that has just begun to drive."""

    def make() -> Kernel:
        kernel = standing()
        kernel.step(DriveRequested(0, 1, Pattern(kind), 0, False, "benchmark"))
        assert kernel.state.mode is Mode.MOVING
        return kernel

    return make


def drive_events(kernel: Kernel) -> Iterator[Event]:
    """Yield ticks and odometry in turn, as the simulated robot gives them; takes the steps."""
    robot = Robot(SimParams())
    for number in range(1, STEPS // 2 + 1):
        t_ns = number * PERIOD_NS
        robot.advance(PERIOD_NS / 1e9)
        odometry = OdomReceived(t_ns, Odometry(robot.odometry, robot.measured, t_ns))
        for event in (odometry, Tick(t_ns)):
            for effect in kernel.step(event):
                if isinstance(effect, PublishTwist):
                    robot.command(effect.twist)
            yield event
        if number % 50 == 0:
            kernel.step(BatteryReceived(t_ns, 1.0))
            yield BatteryReceived(t_ns, 1.0)


def cases() -> Iterator[Case]:
    """Yield every line of the table."""
    odometry = Odometry(Pose(), ZERO, 0)
    still: dict[str, Callable[[int], Event]] = {
        "Tick": Tick,
        "OdomReceived": lambda t_ns: OdomReceived(t_ns, odometry),
        "BatteryReceived": lambda t_ns: BatteryReceived(t_ns, 1.0),
        "CommandPublishersSeen": lambda t_ns: CommandPublishersSeen(t_ns, ()),
        "ModeRequested (idle)": lambda t_ns: ModeRequested(t_ns, 1, 0, "benchmark"),
    }
    for name, event in still.items():
        yield Case(f"IDLE    {name}", standing, tuple(event(i * 1000) for i in range(STEPS)))
    for name in ("Tick", "OdomReceived", "BatteryReceived"):
        events = tuple(still[name](i * 1000) for i in range(STEPS))
        yield Case(f"MOVING  {name}", driving(PatternKind.SQUARE), events)
    for kind in PatternKind:
        make = driving(kind)
        yield Case(f"MOVING  a drive: {kind.value}", make, tuple(drive_events(make())))


def us_per_step(case: Case) -> float:
    """Take all steps of the case once and return their mean cost [us]."""
    step = case.kernel().step
    began = time.process_time_ns()
    for event in case.events:
        step(event)
    return (time.process_time_ns() - began) / 1000.0 / len(case.events)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=7)
    count = parser.parse_args().rounds
    gc.disable()
    lines = tuple(cases())
    rounds: dict[str, list[float]] = {case.name: [] for case in lines}
    for _ in range(count):  # interleaved, so that a busy moment hits every line alike
        for case in lines:
            rounds[case.name].append(us_per_step(case))
    print(f"{'us per step':32} {'median':>7} {'min':>7} {'max':>7}   ({count} rounds)")
    for name, costs in rounds.items():
        print(f"{name:32} {median(costs):7.2f} {min(costs):7.2f} {max(costs):7.2f}")
    worst = max(min(costs) for name, costs in rounds.items() if "a drive" in name)
    print(f"a drive costs at most {worst:.1f} us a step; the promise is {TARGET_US:g}")


if __name__ == "__main__":
    main()
