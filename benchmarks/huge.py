"""Peak memory while huge messages arrive: our recorder, and a plain rclpy subscriber.

    python benchmarks/huge.py                          2 messages of 300 MB, three rounds, 4 minutes
    python benchmarks/huge.py --megabytes 100 --rounds 1

A second process publishes images of the given size. `robotctl start --observe` receives them with a
budget of 96 MB for all that waits to be written; what is larger is counted as dropped. The plain
subscriber takes the bytes with depth 1 and keeps nothing: what it needs is what rclpy, rmw and
Fast DDS hold while they take one message, before a subscriber learns its size. Shown is VmHWM of
/proc/PID/status less its value before the first message, and how many messages were received.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

TOPIC = "/huge"
COUNT = 2
DOMAINS = {"robotctl": "171", "rclpy": "172"}
DEADLINE_S = 60.0

PUBLISHER = f"""
import array, sys, time, rclpy
from sensor_msgs.msg import Image
rclpy.init()
publisher = rclpy.create_node("huge").create_publisher(Image, "{TOPIC}", {COUNT})
size = int(sys.argv[1])
image = Image(height=1, width=size, step=size, encoding="mono8", data=array.array("B", bytes(size)))
print("ready", flush=True)
sys.stdin.readline()
for _ in range({COUNT}):
    publisher.publish(image)
sys.stdin.readline()
"""

SUBSCRIBER = f"""
import rclpy
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node("plain")
node.create_subscription(Image, "{TOPIC}", lambda data: print(len(data), flush=True), 1, raw=True)
print("ready", flush=True)
rclpy.spin(node)
"""


def peak_mb(pid: int) -> float:
    """Return the most memory that a process ever had, in MB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise ValueError(pid)


def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition."""
    end = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > end:
            sys.exit(f"waited {DEADLINE_S:g} s for {what}")
        time.sleep(0.05)


@contextmanager
def publisher(megabytes: int, environment: Mapping[str, str]) -> Iterator[subprocess.Popen[str]]:
    """A process that publishes once for each line it gets, and stays."""
    arguments = [sys.executable, "-c", PUBLISHER, str(megabytes * 1_000_000)]
    process = subprocess.Popen(
        arguments, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin
    assert process.stdout
    process.stdout.readline()
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def send(process: subprocess.Popen[str]) -> None:
    """Publish."""
    assert process.stdin
    process.stdin.write("\n")
    process.stdin.flush()


def plain(megabytes: int, environment: Mapping[str, str]) -> tuple[float, int]:
    """Return the growth of a plain subscriber in MB, and how many messages it received."""
    subscriber = subprocess.Popen(
        [sys.executable, "-c", SUBSCRIBER], env=environment, stdout=subprocess.PIPE, text=True
    )
    assert subscriber.stdout
    try:
        subscriber.stdout.readline()
        with publisher(megabytes, environment) as other:
            time.sleep(3.0)  # discovery
            before = peak_mb(subscriber.pid)
            send(other)
            subscriber.stdout.readline()
            time.sleep(5.0)  # with depth 1 the second may be lost
            return peak_mb(subscriber.pid) - before, 1
    finally:
        subscriber.kill()
        subscriber.wait()


def ours(megabytes: int, environment: Mapping[str, str]) -> tuple[float, int]:
    """Return the growth of our recorder in MB, and how many messages it counted."""

    def robotctl(*arguments: str) -> str:
        command = ["robotctl", *arguments]
        return subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, text=True, check=True
        ).stdout

    def recorder() -> dict[str, int]:
        counts: dict[str, int] = json.loads(robotctl("status", "--json"))["recorder"]
        return counts

    with tempfile.TemporaryDirectory() as folder:
        robotctl("start", "--observe", "--recordings", folder)
        try:
            pid = json.loads(robotctl("status", "--json"))["pid"]
            with publisher(megabytes, environment) as other:
                time.sleep(5.0)  # discovery
                before, dropped = peak_mb(pid), recorder()["dropped"]
                send(other)
                until(lambda: recorder()["dropped"] >= dropped + COUNT, "the messages")
                return peak_mb(pid) - before, recorder()["dropped"] - dropped
        finally:
            robotctl("stop")


def main() -> None:
    """Measure in turn."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--megabytes", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    growth: dict[str, list[float]] = {name: [] for name in DOMAINS}
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(given.rounds):
            for name, measure in (("robotctl", ours), ("rclpy", plain)):
                environment = {
                    **os.environ,
                    "ROS_DOMAIN_ID": DOMAINS[name],
                    "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
                    "XDG_RUNTIME_DIR": folder,
                    "XDG_STATE_HOME": folder,
                }
                mb, messages = measure(given.megabytes, environment)
                growth[name].append(mb)
                print(f"{name:>9} {mb:7.0f} MB more, {messages} messages", flush=True)
    ratio = [mine / other for mine, other in zip(growth["robotctl"], growth["rclpy"], strict=True)]
    medians = {name: statistics.median(values) for name, values in growth.items()}
    print(
        f"median {medians['robotctl']:.0f} and {medians['rclpy']:.0f} MB, ratio"
        f" {statistics.median(ratio):.2f} [{min(ratio):.2f} .. {max(ratio):.2f}]"
    )


if __name__ == "__main__":
    main()
