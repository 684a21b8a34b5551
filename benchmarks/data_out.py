"""Export and convert: CPU time for each message, and memory, of whole processes.

    python benchmarks/data_out.py
    python benchmarks/data_out.py --messages 1000000 --rounds 1     does the memory grow?

The recording holds odometry (92 columns) with random numbers in every field, the hardest to write
as text. In each round every command has its turn; shown are medians, and the lowest and highest.
"""

from __future__ import annotations

import argparse
import os
import random
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from robotctl.recording import Recorder, RecorderOptions, Topic, read_info

GOLDEN = Path(__file__).parents[1] / "tests" / "golden" / "stopped"
ROBOTCTL = Path(sys.executable).with_name("robotctl")
START_NS = 1_700_000_000_000_000_000

EXPORT = ("export", "run", "--topic", "/odom", "-o")
COMMANDS = {
    "export, CSV": (*EXPORT, "out.csv"),
    "export, JSON lines": (*EXPORT, "out.jsonl"),
    "export, Parquet": (*EXPORT, "out.parquet"),
    "convert, zstd": ("convert", "run", "out", "--compression", "zstd"),
    "convert, lz4": ("convert", "run", "out", "--compression", "lz4"),
    "convert, none": ("convert", "run", "out", "--compression", "none"),
}


@dataclass(frozen=True)
class Cost:
    """What one process took."""

    cpu_s: float
    peak_mb: float


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--messages", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    found: dict[str, list[Cost]] = {name: [] for name in COMMANDS}
    with TemporaryDirectory() as scratch:
        record(Path(scratch) / "run", arguments.messages)
        for _ in range(arguments.rounds):
            for name, command in COMMANDS.items():
                found[name].append(cost_of(Path(scratch), command))
    print("| | CPU for a message [us] | messages in a second of CPU | peak of memory [MB] |")
    print("|---|---|---|---|")
    for name, costs in found.items():
        each_us = [cost.cpu_s / arguments.messages * 1e6 for cost in costs]
        span = f"{median(each_us):.1f} [{min(each_us):.1f} .. {max(each_us):.1f}]"
        peak = max(cost.peak_mb for cost in costs)
        print(f"| {name} | {span} | {1e6 / median(each_us):,.0f} | {peak:.0f} |")


def record(folder: Path, count: int) -> None:
    """Record odometry with random numbers, as fast as the recorder takes it."""
    odometry = next(topic for topic in read_info(GOLDEN).topics if topic.name == "/odom")
    options = RecorderOptions(memory_bytes=1 << 30, split_s=1e9, split_bytes=1 << 40)
    recorder = Recorder(folder, options, on_failure=print)
    topic = Topic("/odom", odometry.type_name, odometry.definition)
    channel = recorder.add_topic(topic)
    dice = random.Random(1)
    head = b"\0\1\0\0" + struct.pack("<iII5s3xI10s", 1, 2, 5, b"odom\0", 10, b"base_link\0")
    head += bytes((4 - len(head)) % 8)
    for number in range(count):
        data = head + struct.pack("<85d", *(dice.random() for _ in range(85)))
        at_ns = START_NS + number * 20_000_000
        recorder.write(channel, data, at_ns, at_ns, number, b"odometry")
    dropped = recorder.close().dropped
    assert not dropped, f"{dropped} messages found no memory"


def cost_of(scratch: Path, command: tuple[str, ...]) -> Cost:
    """Run a command in the folder; remove what it made."""
    process = subprocess.Popen([ROBOTCTL, *command], cwd=scratch, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, command
    subprocess.run(["rm", "-r", *scratch.glob("out*")], check=True)
    return Cost(used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3)


if __name__ == "__main__":
    main()
