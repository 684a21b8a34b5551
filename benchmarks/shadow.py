"""What a shadow adds to each step of the kernel [us]: its decision, the comparison, the record.

    python benchmarks/shadow.py

Each round takes the same steps of three drives through a fresh shadow, timed with the CPU clock of
the process. `different` has another gain, so that nearly each tick is recorded. Shown are medians
over the rounds, and the lowest and highest in brackets; the driving kernel is shown beside.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from kernel import drive_events, driving, guarded_by_all
from recording.figures import Figure, table

from robotctl.daemon.control.shadow_run import HandledStep, ShadowRun
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.params import KernelParams
from robotctl.kernel.patterns import PatternKind
from robotctl.kernel.shadow import Shadow

LIMIT_US = 20.0


def handled(make: Callable[[], Kernel]) -> list[HandledStep]:
    """Return the steps of a drive, as the driving kernel has taken them."""
    kernel = make()
    return [
        HandledStep(seq, event, kernel.step(event), kernel.state)
        for seq, event in enumerate(drive_events(make()))
    ]


def us_per_step(begin: Kernel, params: KernelParams, steps: Sequence[HandledStep]) -> float:
    """Let a fresh shadow take all steps; return their mean cost [us]."""
    written: list[bytes] = []
    run = ShadowRun(Shadow(params, begin.state, ()), "", "", written.append)
    began = time.process_time_ns()
    for step in steps:
        run.take((step,))
    took_us = (time.process_time_ns() - began) / 1000.0
    assert not run.warning(), run.warning()
    assert bool(written) is (params != begin.params)
    return took_us / len(steps)


def us_alone(make: Callable[[], Kernel], steps: Sequence[HandledStep]) -> float:
    """Let the driving kernel take all steps; return their mean cost [us]."""
    kernel = make()
    began = time.process_time_ns()
    for step in steps:
        kernel.step(step.event)
    return (time.process_time_ns() - began) / 1000.0 / len(steps)


def main() -> int:
    """Print the table; 1 if a figure is missed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=9)
    count = parser.parse_args().rounds
    gc.disable()
    cases: dict[str, Callable[[], float]] = {}
    for name, make in (
        ("a square", driving(PatternKind.SQUARE)),
        ("a figure-eight", driving(PatternKind.FIGURE_EIGHT)),
        ("every row, walls beside", guarded_by_all),
    ):
        begin, steps = make(), handled(make)
        same = begin.params
        gain = replace(same.tracking, k_x=1.01 * same.tracking.k_x)
        cases[f"{name}, driving"] = partial(us_alone, make, steps)
        for what, params in (("same", same), ("different", replace(same, tracking=gain))):
            cases[f"{name}, {what}"] = partial(us_per_step, begin, params, steps)
    # Interleaved, so that a busy moment hits every line alike.
    rounds = [{name: run() for name, run in cases.items()} for _ in range(count)]
    figures = [Figure(name, None if name.endswith("driving") else LIMIT_US) for name in cases]
    lines, missed = table(figures, rounds)
    print("| us per step | to reach | measured | |\n|---|---|---|---|", *lines, sep="\n")
    print(f"load average {os.getloadavg()[0]:.1f}")
    print(f"{missed} missed." if missed else "All reached.")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
