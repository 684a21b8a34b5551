"""How long after each fault of the simulated robot the daemon commands zero [ms].

    python benchmarks/sim_faults.py -n 10

The times are those that `robotctl sim fault` reports while the robot drives a circle, with the
default configuration.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests.support

from robotctl.sim import SimFault
from tests.support.waiting import until
from tests.support.world import World, new_world

FAULT_S = 2


def measure(world: World, fault: SimFault) -> tuple[float, str]:
    """Cause the fault once while the robot drives; return the time to the stop [ms], and why."""
    until(lambda: world.robotctl("reset").exit_code == 0)
    world.ok("drive", "circle", "--radius", "0.5")
    until(lambda: world.status()["velocity"]["linear"] > 0.3)
    answer = world.answer("sim", "fault", fault.value, "--for", f"{FAULT_S}s")
    time.sleep(FAULT_S)  # a pose that jumps back would end the next drive
    return float(answer["stopped_after_ms"]), str(world.status()["mode_reason"])


def main() -> None:
    """Print a line for each fault."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("-n", type=int, default=10)
    count = parser.parse_args().n
    with new_world() as world:
        default = world.folder / "default.yaml"
        default.write_text("recording.clip_before_s: 0\n")
        world.ok("start", "--sim", "--config", str(default))
        for fault in SimFault:
            found = [measure(world, fault) for _ in range(count)]
            taken = [ms for ms, _ in found]
            print(
                f"{fault.value:10} {median(taken):6.0f} ms [{min(taken):.0f} .. {max(taken):.0f}]  "
                f"{found[-1][1]}",
                flush=True,
            )
        world.ok("stop")


if __name__ == "__main__":
    main()
