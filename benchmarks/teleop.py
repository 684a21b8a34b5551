"""How soon the robot is told to stop when nobody holds it any more, as another process hears it.

    python benchmarks/teleop.py [-n 20]

`robotctl teleop` runs on a terminal of its own, beside a daemon with the simulated robot, and a key
is held until the robot is fast. Then one thing happens:

released       the terminal tells the release of the key; until the first smaller command
repeats end    a terminal without releases sends the key a last time; until the first exact zero
closed         the terminal closes; until the first exact zero
frozen         SIGSTOP; until the first exact zero
killed         SIGKILL; until the first exact zero

The times end when Fast DDS has received the command in this process.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests.support

from geometry_msgs.msg import Twist
from rclpy.node import Node

from tests.support.spinning import node_in
from tests.support.terminals import Terminal
from tests.support.waiting import until
from tests.support.world import World, new_world

FAST_MPS = 0.25
REPEAT_S = 0.033
LIMITS_MS = {"released": 20.0}
ZERO_LIMIT_MS = 150.0
W_DOWN, W_UP = "\x1b[119;1:1u", "\x1b[119;1:3u"


class Listener:
    """The commands, each with the wall-clock time [ns] at which Fast DDS received it."""

    def __init__(self, node: Node) -> None:
        self.heard: list[tuple[int, float]] = []
        take: Any = self._take  # rclpy's own types know a callback of one argument only
        node.create_subscription(Twist, "/cmd_vel", take, 1000)

    def _take(self, command: Any, info: Any) -> None:
        self.heard.append((info["received_timestamp"], command.linear.x))

    def is_fast(self) -> bool:
        return bool(self.heard) and self.heard[-1][1] > FAST_MPS

    def first(self, after_ns: int, smaller_than: float) -> int | None:
        later = (at_ns for at_ns, speed in self.heard if at_ns > after_ns and speed < smaller_than)
        return next(later, None)


def sit(world: World, *, tells_releases: bool) -> Terminal:
    terminal = Terminal("teleop", environment=world.environment)
    terminal.until(r"\x1b\[c")
    terminal.press("\x1b[?0u\x1b[?62c" if tells_releases else "\x1b[?62c")
    terminal.until("q quit")
    return terminal


def hold(terminal: Terminal, listener: Listener) -> None:
    """Hold a key of a terminal that tells releases; press it again after a mishap."""

    def is_fast() -> bool:
        if not listener.heard or listener.heard[-1][1] == 0.0:
            terminal.press(W_UP + W_DOWN)
            time.sleep(0.1)
        return listener.is_fast()

    until(is_fast)
    time.sleep(random.uniform(0.02, 0.06))


def measure(world: World, listener: Listener, what: str) -> float:
    """Return how many milliseconds it took once."""
    terminal = sit(world, tells_releases=what != "repeats end")
    acts: dict[str, Callable[[], object]] = {
        "released": lambda: terminal.press(W_UP),
        "closed": terminal.hang_up,
        "frozen": lambda: os.kill(terminal.pid, signal.SIGSTOP),
        "killed": lambda: os.kill(terminal.pid, signal.SIGKILL),
    }
    try:
        if what in acts:
            hold(terminal, listener)
            speed, asked_ns = listener.heard[-1][1], time.time_ns()
            acts[what]()
        else:
            speed = 0.0
            while not listener.is_fast():
                asked_ns = time.time_ns()
                terminal.press("w")
                time.sleep(REPEAT_S)
        smaller_than = speed if what == "released" else 1e-12
        found_ns: Any = until(lambda: listener.first(asked_ns, smaller_than))
        return float(found_ns - asked_ns) / 1e6
    finally:
        terminal.close()
        until(lambda: world.status()["lease"] is None and world.status()["mode"] == "IDLE")


def main() -> int:
    """Print the table; 1 if a time is above its limit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-n", type=int, default=20, help="times of each")
    count = parser.parse_args().n
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    missed = 0
    ways = ("released", "repeats end", "closed", "frozen", "killed")
    with new_world() as world:
        world.ok("start", "--sim")
        until(lambda: world.status()["pose"] and world.status()["battery"])
        with node_in(world.domain_id, "listener") as node:
            listener = Listener(node)
            taken: dict[str, list[float]] = {way: [] for way in ways}
            for _ in range(count):
                for way, values in taken.items():
                    values.append(measure(world, listener, way))
        world.ok("stop")
    print("| what happens | median [ms] | lowest .. highest | wanted | |")
    print("|---|---|---|---|---|")
    for way, values in taken.items():
        limit_ms = LIMITS_MS.get(way, ZERO_LIMIT_MS)
        reached = max(values) <= limit_ms
        missed += not reached
        print(
            f"| {way} | {statistics.median(values):.1f} | {min(values):.1f} .. {max(values):.1f} "
            f"| <= {limit_ms:g} | {'reached' if reached else 'MISSED'} |"
        )
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
