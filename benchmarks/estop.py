"""How long an emergency stop takes: from the request to an exact zero in another process.

    python benchmarks/estop.py                        about 20 minutes
    python benchmarks/estop.py -n 20 --rounds 1       a short look

The robot moves at each request, and is reset afterwards. A second process makes the request and
receives the commands: the time runs from before this client connects, or calls, to the moment when
Fast DDS receives the first Twist of zeros. Each round goes through all situations, and in each
situation through all ways to request a stop. Loads run in further processes on the same machine;
their measured rates are printed with the figures.

idle           no load
recorded       1,000 messages of 724 B a second are recorded
flooded        /set_mode is called 1,000 times a second, half for MOVING, half for an unknown mode;
               each stop comes while a request for IDLE waits for the end of its ramp
connected      1,000 idle connections to the control socket; one that the daemon closes is opened
               again about a second later

No clips are cut (`recording.clip_before_s: 0`): they are not made for a stop every half second.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import statistics
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests.support

from recording import publisher
from stopping.loads import SITUATIONS, Bench
from stopping.witness import Witness

from tests.support.ros_peer import node_in
from tests.support.world import PATIENT, new_world

P99_LIMIT_MS = 20.0
TICK_S = 0.02

CONFIG = f"""{PATIENT}
sim.battery_life_s: 1.0e+6
pattern.kind: circle
"""

Results = dict[tuple[str, str], list[list[float]]]
"""Times to stop [ms] in each round, by situation and way to request the stop."""


def main() -> int:
    arguments = parse()
    results: Results = defaultdict(list)
    with tempfile.TemporaryDirectory() as scratch, new_world() as world:
        config = world.folder / "estop.yaml"
        config.write_text(CONFIG)
        os.environ.update(
            {name: world.environment[name] for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME")}
        )
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        world.ok("start", "--sim", "--config", str(config))
        socket = world.status()["socket"]
        bench = Bench(publisher.build(Path(scratch)), socket, world.environment, {})
        with node_in(world.domain_id, "witness") as node:
            beside = Witness(node)
            for number in range(arguments.rounds):
                for name in arguments.situations:
                    print(f"round {number + 1}: {name}", file=sys.stderr)
                    with SITUATIONS[name](bench):
                        count = arguments.n // arguments.rounds
                        for way, taken in measure(beside, count, ramping=name == "flooded").items():
                            results[name, way].append(taken)
        world.ok("stop")
    missed = table(results)
    for name, values in bench.offered.items():
        print(
            f"offered: {name} {statistics.median(values):,.0f} [{min(values):,.0f} .. "
            f"{max(values):,.0f}]"
        )
    print(f"\n{missed} missed." if missed else "\nAll reached.")
    return 1 if missed else 0


def measure(beside: Witness, count: int, *, ramping: bool) -> dict[str, list[float]]:
    """Request `count` stops in each way, in turns, at random times between two ticks.

    Return the times to stop [ms] by way.
    """
    taken: dict[str, list[float]] = {way: [] for way in beside.ways}
    for _ in range(count):
        for way, values in taken.items():
            after_s = random.uniform(TICK_S, 3 * TICK_S)
            values.append(beside.measure(way, after_s, ramping=ramping))
    return taken


def table(results: Results) -> int:
    """Print a line for each situation and way; return how many are above the limit."""
    missed = 0
    print("| situation | asked by | p50 [ms] | p99 [ms] | max [ms] | never | n | |")
    print("|---|---|---|---|---|---|---|---|")
    for (situation, way), rounds in results.items():
        every = [value for values in rounds for value in values]
        reached = percentile(every, 0.99) <= P99_LIMIT_MS
        missed += not reached
        p50 = spread(percentile(every, 0.5), [percentile(each, 0.5) for each in rounds])
        p99 = spread(percentile(every, 0.99), [percentile(each, 0.99) for each in rounds])
        never = sum(map(math.isinf, every))
        verdict = "reached" if reached else "MISSED"
        print(
            f"| {situation} | {way} | {p50} | {p99} | {max(every):.1f} | {never} | {len(every)} "
            f"| {verdict} |"
        )
    return missed


def percentile(values: list[float], share: float) -> float:
    return sorted(values)[math.ceil(share * len(values)) - 1]


def spread(value: float, of_rounds: list[float]) -> str:
    """Return the value over all rounds with the lowest and highest of a round, as text."""
    return f"{value:.1f} [{min(of_rounds):.1f} .. {max(of_rounds):.1f}]"


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-n", type=int, default=200, help="stops by each way in each situation")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--situations", default=",".join(SITUATIONS), help="which, with commas")
    arguments = parser.parse_args()
    arguments.situations = arguments.situations.split(",")
    if unknown := set(arguments.situations) - set(SITUATIONS):
        parser.error(f"unknown situations {sorted(unknown)}; there are {', '.join(SITUATIONS)}")
    if not 1 <= arguments.rounds <= arguments.n:
        parser.error("at least one stop a round")
    return arguments


if __name__ == "__main__":
    sys.exit(main())
