"""What one `Kernel.step` costs [us], by mode and kind of event.

    python benchmarks/kernel.py

Each round runs the same steps in a fresh kernel, timed by the CPU clock of the process. Shown are
medians over the rounds, and the lowest and highest in brackets. A drive on any pattern, and one
with every input required, must take at most 20 us a step, and a scan at most 80 us.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import pi, sin, tau

from recording.figures import Figure, table

from robotctl.kernel.fence import FenceParams
from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import KernelParams, ScanParams
from robotctl.kernel.patterns import Pattern, PatternKind
from robotctl.kernel.safety_inputs import (
    BumperParams,
    DiagnosticsParams,
    EstopParams,
    JoyParams,
    SafetyInput,
    SafetyInputParams,
    TiltParams,
    Use,
)
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
    SafetyInputReceived,
    ScanReceived,
    Tick,
)
from robotctl.sim import Robot, SimParams

STEPS = 4_000
TARGET_US, SCAN_TARGET_US = 20.0, 80.0
PERIOD_NS = 20_000_000

BESIDE = tuple(
    min(0.4 / max(abs(sin(angle)), 1e-9), 20.0)
    for angle in (-pi + (number + 0.5) * tau / 64 for number in range(64))
)
"""The sectors of a scan between two walls, each 0.4 m away."""


@dataclass(frozen=True, slots=True)
class Case:
    """One line of the table: a kernel to begin with, and the events to feed it."""

    name: str
    kernel: Callable[[], Kernel]
    events: tuple[Event, ...]
    limit_us: float | None = None


def standing() -> Kernel:
    """Return a kernel in IDLE whose start conditions hold."""
    kernel = Kernel(KernelParams())
    kernel.step(Tick(0))
    kernel.step(BatteryReceived(0, 1.0))
    kernel.step(OdomReceived(0, Odometry(Pose(), ZERO, 0)))
    return kernel


def driving(kind: PatternKind) -> Callable[[], Kernel]:
    """Return a function that makes a kernel that has just begun to drive."""

    def make() -> Kernel:
        kernel = standing()
        kernel.step(DriveRequested(0, 1, Pattern(kind), 0, False, "benchmark"))
        assert kernel.state.mode is Mode.MOVING
        return kernel

    return make


def guarded_by_all() -> Kernel:
    """Return a kernel that has begun to drive with every input required, and a fence."""
    inputs = SafetyInputParams(
        EstopParams(use=Use.REQUIRED, timeout_s=60.0),
        JoyParams(use=Use.REQUIRED, timeout_s=60.0),
        BumperParams(use=Use.REQUIRED, timeout_s=60.0),
        TiltParams(use=Use.REQUIRED, timeout_s=60.0),
        DiagnosticsParams(use=Use.REQUIRED, timeout_s=60.0),
    )
    params = replace(
        KernelParams(),
        inputs=inputs,
        scan=ScanParams(use=Use.REQUIRED, timeout_s=60.0),
        fence=FenceParams(radius_m=50.0),
    )
    kernel = Kernel(params)
    kernel.step(Tick(0))
    for event in (BatteryReceived(0, 1.0), OdomReceived(0, Odometry(Pose(), ZERO, 0))):
        kernel.step(event)
    for kind in SafetyInput:
        kernel.step(SafetyInputReceived(0, kind, 0.0))
    kernel.step(ScanReceived(0, BESIDE))
    kernel.step(DriveRequested(0, 1, Pattern(PatternKind.LINE, 50.0), 1, False, "benchmark"))
    assert kernel.state.mode is Mode.MOVING, kernel.state
    return kernel


def drive_events(kernel: Kernel) -> Iterator[Event]:
    """Yield odometry of a simulated robot, ticks and battery levels; step `kernel` with each."""
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
    events = tuple(drive_events(guarded_by_all()))
    yield Case("MOVING  every row, walls beside", guarded_by_all, events, TARGET_US)
    scans = tuple(ScanReceived(i * 1000, BESIDE) for i in range(STEPS))
    yield Case("MOVING  ScanReceived, walls beside", guarded_by_all, scans, SCAN_TARGET_US)
    for kind in PatternKind:
        make = driving(kind)
        events = tuple(drive_events(make()))
        yield Case(f"MOVING  a drive: {kind.value}", make, events, TARGET_US)


def us_per_step(case: Case) -> float:
    """Run all steps of the case once, and return their mean cost [us]."""
    step = case.kernel().step
    began = time.process_time_ns()
    for event in case.events:
        step(event)
    return (time.process_time_ns() - began) / 1000.0 / len(case.events)


def main() -> int:
    """Print the table; return 1 if a figure is missed, else 0."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=7)
    count = parser.parse_args().rounds
    gc.disable()
    each = tuple(cases())
    # Interleaved, so that a busy moment hits every line alike.
    rounds = [{case.name: us_per_step(case) for case in each} for _ in range(count)]
    lines, missed = table([Figure(case.name, case.limit_us) for case in each], rounds)
    print("| us per step | to reach | measured | |\n|---|---|---|---|", *lines, sep="\n")
    print(f"load average {os.getloadavg()[0]:.1f}")
    print(f"{missed} missed." if missed else "All reached.")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
