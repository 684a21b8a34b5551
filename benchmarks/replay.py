"""How exactly, how fast and how soon a recording is played to ROS.

    python benchmarks/replay.py                                       about 15 minutes
    python benchmarks/replay.py --figures pacing,max --rounds 3 --seconds 3

pacing   1 kHz, inter-arrival error where messages are passed to the middleware: this player against
         absolute asyncio.sleep and against a player that waits on a condition variable for each
         message, as rosbag2's does. All three play in turn within a round, the same recording
         through the same publisher to one subscriber in another process; ratios within a round.
steady   `robotctl replay` of 100 Hz as another process receives it: inter-arrival error by the
         middleware's `received_timestamp`, and losses. That process runs under SCHED_FIFO where
         permitted, so that a late wake-up of the receiver does not count.
drive    the same of a simulated drive (`robotctl demo`).
max      `--rate max`, 724 B, one reliable subscriber.
first    from the command to the first message at a waiting subscriber, 1 GB file, from its
         beginning and from its middle; and how long a reader alone takes to that message.

Shown are medians over the rounds, and the lowest and highest in brackets.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from replaying.listener import DEADLINE_S, listen, listening, subject
from replaying.material import ODOMETRY, ODOMETRY_BYTES, QOS, ROBOTCTL, a_drive, write_steady
from replaying.players import PLAYERS

from robotctl.base import environment
from robotctl.base.domains import reserved_domain
from robotctl.recording import Recording, read_info, read_messages

ARRIVAL = ("steady", "drive")
CONTENDERS = ("robotctl", "asyncio", "condition")


@dataclass(frozen=True)
class Errors:
    """Inter-arrival errors [us]."""

    p50: float
    p99: float
    worst: float

    @classmethod
    def of(cls, times_ns: Sequence[int], recorded_ns: Sequence[int]) -> Errors:
        """Return by how much the gaps between messages differ from those in the recording."""
        gaps = zip(pairwise(times_ns), pairwise(recorded_ns), strict=True)
        found = sorted(abs((b - a) - (d - c)) / 1e3 for (a, b), (c, d) in gaps)
        return cls(found[len(found) // 2], found[int(len(found) * 0.99)], found[-1])


def replay(file: Path, *arguments: str) -> tuple[dict[str, Any], float]:
    """Run `robotctl replay --json`; return its summary, and when it was started [s since epoch]."""
    begin = time.time()
    command = [*ROBOTCTL, "replay", str(file), "--json", *arguments]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    found: dict[str, Any] = json.loads(ran.stdout)
    return found, begin


def spread(values: Sequence[float], form: str = ".0f") -> str:
    """Return `MEDIAN [LOWEST .. HIGHEST]` as text."""
    low, middle, high = min(values), statistics.median(values), max(values)
    return f"{middle:{form}} [{low:{form}} .. {high:{form}}]"


class Table:
    """Prints the figures, and keeps those that miss their target in `missed`."""

    def __init__(self) -> None:
        self.missed: list[str] = []

    def row(self, name: str, value: str, target: str = "", reached: bool = True) -> None:
        """Print one line; with a target also whether the target is reached."""
        verdict = "" if not target else f"   to reach: {target}   {'yes' if reached else 'NO'}"
        print(f"  {name:34} {value:30}{verdict}", flush=True)
        if not reached:
            self.missed.append(f"{name}: {value} (to reach: {target})")


def pacing(table: Table, rounds: int, seconds: float, scratch: Path) -> None:
    """Measure the inter-arrival error where messages are passed to the middleware, at 1 kHz."""
    print("pacing: inter-arrival error at publish, 1 kHz [us]")
    found: dict[str, list[Errors]] = {name: [] for name in CONTENDERS}
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        file = write_steady(Path(folder) / "steady", 1000.0, round(seconds * 1000))
        recorded = [message.log_ns for message in read_messages(file)]
        with listening([["/odom", ODOMETRY, QOS]]):
            for number in range(rounds):
                for name in CONTENDERS[number % 3 :] + CONTENDERS[: number % 3]:
                    process = subject("--play", name, str(file))
                    out, _ = process.communicate(timeout=DEADLINE_S + seconds)
                    found[name].append(Errors.of(json.loads(out), recorded))
    for name, errors in found.items():
        for share in ("p50", "p99", "worst"):
            table.row(f"{name} {share}", spread([getattr(each, share) for each in errors], ".1f"))
    for other, target in (("asyncio", 1 / 20), ("condition", 1 / 4)):
        for share in ("p50", "p99"):
            ratios = [
                getattr(ours, share) / getattr(theirs, share)
                for ours, theirs in zip(found["robotctl"], found[other], strict=True)
            ]
            reached = statistics.median(ratios) <= target
            table.row(
                f"{share} / {other}", spread(ratios, ".3f"), f"<= 1/{round(1 / target)}", reached
            )


def steady(table: Table, runs: int, seconds: float, scratch: Path) -> None:
    """Measure the inter-arrival error at the receiver, and losses, at 100 Hz."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        file = write_steady(Path(folder) / "steady", 100.0, round(seconds * 100))
        arrival(table, "100 Hz", file, runs, seconds)


def drive(table: Table, runs: int, seconds: float, scratch: Path) -> None:
    """Measure the same of a simulated drive."""
    with a_drive(scratch) as file:
        arrival(table, "a drive", file, runs, seconds)


def arrival(table: Table, name: str, file: Path, runs: int, seconds: float) -> None:
    print(f"arrival: {name}, inter-arrival error by received_timestamp [ms], {runs} runs")
    topics = [topic for topic in read_info(file).topics if topic.message_count]
    with Recording(file) as recording:
        start_ns = recording.info().start_ns
        window = (start_ns, start_ns + round(seconds * 1e9))
        messages = list(recording.messages(None, print, window))
    recorded = [[m.log_ns for m in messages if m.topic == topic.name] for topic in topics]
    wanted = [[f"/{t.name.lstrip('/')}", t.type_name, t.offered_qos] for t in topics]
    found: dict[str, list[Errors]] = {topic.name: [] for topic in topics}
    lost = sent = 0
    commands = ",".join(topic.name for topic in topics)
    for _ in range(runs):
        with listening(wanted, urgent=True) as listener:
            replay(file, "--duration", str(seconds), "--topics", commands)
            heard = listener.heard(len(messages))
        sent += len(messages)
        lost += len(messages) - len(heard)
        for number, topic in enumerate(topics):
            times = [at_ns for which, at_ns in heard if which == number]
            if len(times) == len(recorded[number]) and len(times) > 100:
                found[topic.name].append(Errors.of(times, recorded[number]))
    for topic_name, errors in found.items():
        if errors:
            p50s, p99s = [e.p50 / 1e3 for e in errors], [e.p99 / 1e3 for e in errors]
            table.row(f"{topic_name[-26:]} p50", spread(p50s, ".3f"))
            reached = statistics.median(p99s) <= 0.3
            table.row(f"{topic_name[-26:]} p99", spread(p99s, ".3f"), "<= 0.3", reached)
            table.row(f"{topic_name[-26:]} at most", spread([e.worst / 1e3 for e in errors], ".3f"))
    table.row("lost", f"{lost} of {sent}", "0", lost == 0)


def full_speed(table: Table, rounds: int, _: float, scratch: Path) -> None:
    """Measure the rate and the losses of `--rate max`."""
    count = 200_000
    print(f"max: {count} messages of {ODOMETRY_BYTES} B to one reliable subscriber")
    rates, lost = [], 0
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        file = write_steady(Path(folder) / "steady", 1000.0, count)
        for _round in range(rounds):
            with listening([["/odom", ODOMETRY, QOS]]) as listener:
                replay(file, "--rate", "max")
                heard = listener.heard(count, patience_s=10.0)
            lost += count - len(heard)
            times = [at_ns for _number, at_ns in heard]
            rates.append(len(times) / (max(times) - min(times)) * 1e9)
    table.row("messages/s", spread(rates), ">= 20000", statistics.median(rates) >= 20_000)
    table.row("lost", f"{lost} of {count * rounds}", "0", lost == 0)


def first(table: Table, rounds: int, _: float, scratch: Path) -> None:
    """Measure the time to the first message of a 1 GB file."""
    count = 1_380_000
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        file = write_steady(Path(folder) / "large", 1000.0, count)
        size = sum(path.stat().st_size for path in file.glob("*.mcap"))
        print(f"first: {size / 1e9:.2f} GB, {count} messages [s]")
        for name, offset in (("from its beginning", "0"), ("from its middle", "690")):
            reading, taken = [], []
            for _round in range(rounds):
                begin = time.monotonic()
                with Recording(file) as recording:
                    start_ns = recording.info().start_ns + int(offset) * 1_000_000_000
                    next(recording.messages(None, print, (start_ns, 1 << 63)))
                reading.append(time.monotonic() - begin)
                with listening([["/odom", ODOMETRY, QOS]]) as listener:
                    _summary, begun = replay(file, "--start-offset", offset, "--duration", "0.5")
                    heard = listener.heard(400)
                taken.append(min(at_ns for _number, at_ns in heard) / 1e9 - begun)
            reached = statistics.median(reading) <= 1.0
            table.row(f"{name}, reading", spread(reading, ".3f"), "<= 1", reached)
            reached = statistics.median(taken) <= 0.5
            table.row(f"{name}, command to message", spread(taken, ".2f"), "<= 0.5", reached)


FIGURES: dict[str, Callable[[Table, int, float, Path], None]] = {
    "pacing": pacing,
    "steady": steady,
    "drive": drive,
    "max": full_speed,
    "first": first,
}


def main() -> None:
    """Run the chosen figures, or be one of their processes: `--play` or `--listen`."""
    environment.prepare()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--figures", default=",".join(FIGURES), help="which, with commas")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--runs", type=int, default=20, help="of `steady` and `drive`")
    parser.add_argument("--seconds", type=float, default=5.0, help="of one measurement")
    parser.add_argument("--scratch", type=Path, default=Path(tempfile.gettempdir()))
    parser.add_argument("--play", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--listen", help=argparse.SUPPRESS)
    parser.add_argument("--urgent", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.play:
        name, file = options.play
        stamps = PLAYERS[name](Path(file), int(os.environ["ROS_DOMAIN_ID"]))
        print(json.dumps(stamps), flush=True)
        return
    if options.listen:
        listen(json.loads(options.listen), urgent=options.urgent)
        return
    with tempfile.TemporaryDirectory() as private, reserved_domain() as domain_id:
        os.environ["ROS_DOMAIN_ID"] = str(domain_id)
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"] = private
        table = Table()
        for name in options.figures.split(","):
            rounds = options.runs if name in ARRIVAL else options.rounds
            FIGURES[name](table, rounds, options.seconds, options.scratch)
    print("\nNot reached:" if table.missed else "\nAll reached.")
    for line in table.missed:
        print(f"  {line}")


if __name__ == "__main__":
    main()
