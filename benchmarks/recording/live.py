"""The recorder under real traffic: one process publishes, another one receives."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from recording import publisher, subject
from recording.figures import Figure
from recording.subject import Measured

END_TIMEOUT_S = 60.0

_numbers = itertools.count(1)


@dataclass(frozen=True)
class Load:
    """What is published: type and size [bytes] of the messages, and their rate [1/s]."""

    type_name: str
    size: int
    rate: float


@dataclass(frozen=True)
class Bench:
    """Where and how long to measure; `library` is the publisher in C++, "" without a compiler."""

    library: str
    seconds: float
    scratch: Path
    domain_id: int

    def run(self, contender: str, load: Load, *, ticks: bool = False) -> tuple[Measured, float]:
        """Run a contender under a load; return its result, and the rate that was really sent."""
        with self.running(contender, load, self.seconds, ticks=ticks) as (taker, publishing):
            assert taker.stdout is not None
            line = taker.stdout.readline()
            if not line:
                raise SystemExit(f"{contender} ended before it had measured")
            sent = json.loads(_end(publishing))
        return Measured(**json.loads(line)), sent["per_second"]

    @contextmanager
    def running(
        self, contender: str, load: Load, seconds: float, *, ticks: bool = False
    ) -> Iterator[tuple[subprocess.Popen[str], subprocess.Popen[str]]]:
        """Run a receiver and a publisher on a new topic during the block; yield both."""
        topic = f"/load_{os.getpid()}_{next(_numbers)}"
        with tempfile.TemporaryDirectory(dir=self.scratch) as folder:
            taking = [subject.__file__, contender, topic, str(seconds), str(int(ticks)), folder]
            sending = [publisher.__file__, self.library, topic, load.type_name]
            sending += [str(load.size), str(load.rate)]
            processes: list[subprocess.Popen[str]] = []
            try:
                processes.append(_start(taking, self.domain_id))
                processes.append(_start(sending, self.domain_id))
                yield processes[0], processes[1]
                _end(processes[1])
                _end(processes[0])
            finally:
                for process in processes:
                    process.kill()
                    process.wait()


def _start(command: list[str], domain_id: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={
            **os.environ,
            "ROS_DOMAIN_ID": str(domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        },
    )


def _end(process: subprocess.Popen[str]) -> str:
    """End a process by closing its stdin; return its output."""
    if process.stdin is None or process.stdin.closed:
        return ""
    output, _ = process.communicate(timeout=END_TIMEOUT_S)
    if process.returncode:
        raise SystemExit(f"{process.args!r} failed with {process.returncode}")
    return output


SMALL, MIDDLE, LARGE = ("twist", 52), ("odometry", 724), ("image", 1_000_000)
NAMES = {SMALL: "52 B", MIDDLE: "724 B", LARGE: "1 MB"}


# End to end against the usual way in Python.

END_TO_END_HZ = 5000.0
END_TO_END = "recording CPU / SingleThreadedExecutor + mcap, 5k msg/s"
END_TO_END_US = "recording at 5k msg/s [us per message]"
CLASSIC_US = "SingleThreadedExecutor + mcap at 5k msg/s [us per message]"


def end_to_end_figures() -> Iterator[Figure]:
    yield Figure(END_TO_END, 0.2)
    yield Figure(END_TO_END_US, digits=".1f")
    yield Figure(CLASSIC_US, digits=".1f")


def end_to_end(bench: Bench) -> Iterator[tuple[str, float]]:
    load = Load(*SMALL, END_TO_END_HZ)
    ours, _ = bench.run("zstd", load)
    classic, _ = bench.run("classic", load)
    yield END_TO_END, ours.cpu_us / classic.cpu_us
    yield END_TO_END_US, ours.cpu_us
    yield CLASSIC_US, classic.cpu_us


# What recording adds to taking.

ADDED_HZ = 10_000.0
ADDED_LIMITS_US = {SMALL: 3.0, MIDDLE: 4.0}


def _added_name(kind: tuple[str, int], compression: str) -> str:
    return f"added to a bare raw take, {NAMES[kind]}, {compression} [us per message]"


def added_figures() -> Iterator[Figure]:
    for kind, limit in ADDED_LIMITS_US.items():
        for compression in ("none", "zstd"):
            yield Figure(_added_name(kind, compression), limit)


def added(bench: Bench) -> Iterator[tuple[str, float]]:
    for kind in ADDED_LIMITS_US:
        load = Load(*kind, ADDED_HZ)
        bare, _ = bench.run("bare", load)
        for compression in ("none", "zstd"):
            ours, _ = bench.run(compression, load)
            yield _added_name(kind, compression), ours.cpu_us - bare.cpu_us


# What the loop feels of it.

LAG_LOADS = {"20k msg/s": Load(*SMALL, 20_000.0), "100 MB/s": Load(*LARGE, 100.0)}
LAG_LIMIT_MS = 1.0


def lag_figures() -> Iterator[Figure]:
    for name in LAG_LOADS:
        yield Figure(f"loop lag p99.9 at {name}, above a bare raw take [ms]", LAG_LIMIT_MS)
        yield Figure(f"loop lag p99.9 at {name}, of the bare raw take [ms]")


def lag(bench: Bench) -> Iterator[tuple[str, float]]:
    for name, load in LAG_LOADS.items():
        bare, _ = bench.run("bare", load, ticks=True)
        ours, _ = bench.run("zstd", load, ticks=True)
        yield f"loop lag p99.9 at {name}, above a bare raw take [ms]", ours.lag_ms - bare.lag_ms
        yield f"loop lag p99.9 at {name}, of the bare raw take [ms]", bare.lag_ms


# The highest rate at which nothing is lost.

RATES_HZ = {
    SMALL: (60_000.0, 45_000.0, 30_000.0, 15_000.0),
    MIDDLE: (60_000.0, 45_000.0, 30_000.0, 20_000.0, 10_000.0),
}
RATE_LIMITS_HZ = {SMALL: 45_000.0, MIDDLE: 30_000.0}
FULL_RATE = 0.98
"""The share of a rate that must really have been sent, or the rate does not count."""


def _rate_name(kind: tuple[str, int]) -> str:
    return f"rate without loss, {NAMES[kind]} [msg/s]"


def rate_figures() -> Iterator[Figure]:
    for kind, limit in RATE_LIMITS_HZ.items():
        yield Figure(_rate_name(kind), limit, at_least=True, digits=".0f")


def rate(bench: Bench) -> Iterator[tuple[str, float]]:
    for kind, rates in RATES_HZ.items():
        yield _rate_name(kind), next((hz for hz in rates if _keeps_all(bench, kind, hz)), 0.0)


def _keeps_all(bench: Bench, kind: tuple[str, int], hz: float) -> bool:
    ours, sent_hz = bench.run("zstd", Load(*kind, hz))
    print(
        f"    {NAMES[kind]} at {hz:,.0f}/s: sent {sent_hz:,.0f}/s, took {ours.per_second:,.0f}/s"
        f" at {ours.cpu_us:.1f} us, lost {ours.lost:,}, dropped {ours.dropped:,}",
        file=sys.stderr,
    )
    return not ours.lost and not ours.dropped and sent_hz >= FULL_RATE * hz


# Images.

IMAGES_HZ = 400.0
IMAGES_LIMIT = 0.85


def _images_name(compression: str) -> str:
    return f"1 MB images at {IMAGES_HZ:.0f}/s, {compression} / raw take + file.write"


def images_figures() -> Iterator[Figure]:
    for compression in ("none", "zstd"):
        yield Figure(_images_name(compression), IMAGES_LIMIT, at_least=True)
    yield Figure("1 MB images a second, raw take + file.write", digits=".0f")


def images(bench: Bench) -> Iterator[tuple[str, float]]:
    load = Load(*LARGE, IMAGES_HZ)
    plain, _ = bench.run("plain", load)
    yield "1 MB images a second, raw take + file.write", plain.per_second
    for compression in ("none", "zstd"):
        ours, _ = bench.run(compression, load)
        kept = ours.per_second - ours.dropped / bench.seconds
        yield _images_name(compression), kept / plain.per_second
