"""What an answer of `status` costs the daemon's loop, and how long its client waits.

    python benchmarks/status.py                         about 40 seconds
    python benchmarks/status.py --topics 1000
    python benchmarks/status.py --changing 30           30 have messages between any two answers

A daemon that only observes records topics of another process, which publishes on each once a
second, all at once; with --changing on so many 25 times a second, and not on the others. Loop is
the CPU time of the loop's thread (/proc/PID/task/PID/schedstat) for each answer, less what it
takes in as much time without answers; it includes reading the request and sending the answer.
Client is from the request to the decoded answer. Shown are medians over the rounds, and the lowest
and highest in brackets.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests.support

from rclpy.node import Node
from std_msgs.msg import String

from robotctl import environment
from robotctl.ipc.client import Client
from robotctl.ipc.method_names import STATUS
from tests.support.spinning import node_in
from tests.support.waiting import until
from tests.support.world import World, new_world

LIMIT_MS = 1.0
ANSWERS = 60
PERIOD_S = 0.05
"""From one request to the next: long enough for caches to be as cold as they are in use. All
answers take whole seconds, so that as many messages come as in the same time without answers."""

CHANGING_S = 0.04


def publish(node: Node, topics: int, changing: int) -> None:
    """Publish on so many topics, named as those of a robot are."""
    names = [f"/robot/sensors/device_{number:03}/filtered" for number in range(topics)]
    publishers = [node.create_publisher(String, name, 1) for name in names]

    def publish_on_all() -> None:
        for publisher in publishers[:changing]:
            publisher.publish(String(data="x" * 100))

    node.create_timer(1.0 if changing == topics else CHANGING_S, publish_on_all)


def spread(values: Sequence[float]) -> str:
    """Median [lowest .. highest]."""
    return f"{statistics.median(values):.2f} [{min(values):.2f} .. {max(values):.2f}]"


def loop_s(pid: int) -> float:
    """CPU time of the loop's thread."""
    return int(Path(f"/proc/{pid}/task/{pid}/schedstat").read_text().split()[0]) / 1e9


def during(pid: int, work: Callable[[], object]) -> float:
    """CPU time of the loop's thread [s] while `work` is begun each PERIOD_S, ANSWERS times."""
    before, due = loop_s(pid), time.monotonic()
    for _ in range(ANSWERS):
        work()
        due += PERIOD_S
        time.sleep(max(due - time.monotonic(), 0.0))
    return loop_s(pid) - before


def measure(world: World, topics: int, rounds: int) -> bool:
    """Print the figures; return whether the loop's one is reached."""

    def status() -> None:
        begun = time.perf_counter()
        client.call(STATUS)
        waited_ms.append((time.perf_counter() - begun) * 1e3)

    world.ok("start", "--observe")
    until(lambda: len(world.status()["topics"]) >= topics)
    pid, waited_ms, taken_ms = world.status()["pid"], list[float](), list[float]()
    os.environ["XDG_RUNTIME_DIR"] = world.environment["XDG_RUNTIME_DIR"]  # where its socket is
    with Client("robot") as client:
        during(pid, lambda: None)  # until all topics are subscribed to
        answer = client.call(STATUS)
        for _ in range(rounds):
            idle_s = during(pid, lambda: None)
            taken_ms.append((during(pid, status) - idle_s) / ANSWERS * 1e3)
    world.ok("stop")
    size = len(json.dumps(answer, separators=(",", ":")))
    reached = statistics.median(taken_ms) <= LIMIT_MS
    print(f"{len(answer['topics'])} topics, {size / 1000:.0f} kB an answer")
    verdict = "yes" if reached else "NO"
    print(f"loop   [ms]  {spread(taken_ms)}   to reach: <= {LIMIT_MS:g}   {verdict}")
    print(f"client [ms]  {spread(waited_ms)}")
    return reached


def main() -> int:
    """Measure; return 1 where the figure is not reached."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--topics", type=int, default=500)
    parser.add_argument("--changing", type=int, help="how many have messages all the time")
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    environment.prepare()
    with new_world() as world, node_in(world.domain_id, "sensors") as node:
        changing = options.topics if options.changing is None else options.changing
        publish(node, options.topics, changing)
        return 0 if measure(world, options.topics, options.rounds) else 1


if __name__ == "__main__":
    sys.exit(main())
