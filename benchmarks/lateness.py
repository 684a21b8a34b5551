"""How late the control tick of a daemon is while it drives a square and records other traffic.

    python benchmarks/lateness.py                             100 Hz, 5,000 messages a second, 60 s
    python benchmarks/lateness.py --rounds 3 --size 52
    python benchmarks/lateness.py --messages 0                without traffic, for comparison
    python benchmarks/lateness.py --indexing recordings/robot_20261124_101500
                                        while that recording is indexed again and again

The traffic comes from another process, in C++ where there is a compiler. Each tick is an event of
the journal, with the time when the loop received it and the number of ticks skipped before it.
Ticks are due at multiples of the period, but the phase is not recorded, so lateness counts from the
most punctual tick (a ticker alone is late by less than 0.1 ms, see executor.py). A skipped tick
counts as late until the next tick came.

Also shown: how much of the traffic is not in the recording; how long the loop's thread waited for a
processor, per second; and the lateness of a ticker in another process without other work. On a busy
machine both tickers are late because no processor is free.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from footprint import daemon, environment
from recording import publisher
from recording.figures import Figure, Round, table

from robotctl.base.domains import reserved_domain
from robotctl.base.jobs import job_command
from robotctl.base.processes import start
from robotctl.daemon.recording.housekeeping import INDEX
from robotctl.kernel.types import Tick
from robotctl.recording import Recording, read_journal
from robotctl.ros import Ticker

WARM_UP_S = 5.0
END_TIMEOUT_S = 20.0
LOAD = "/load"

P50, P99, MAX = "lateness p50 [ms]", "lateness p99 [ms]", "latest tick [ms]"
MISSED = "missed ticks in 60 s"
SENT, LOST = "messages sent a second", "of these not in the recording [%]"
BARE_P99, BARE_MISSED = "a bare ticker, p99 [ms]", "a bare ticker, missed in 60 s"
CPU, WAITED = "CPU of the daemon [%]", "waited for a processor [ms/s]"
FIGURES = (
    Figure(P50, digits=".3f"),
    Figure(P99, 1.0, digits=".3f"),
    Figure(MAX, digits=".2f"),
    Figure(MISSED, 1.0, digits=".1f"),
    Figure(BARE_P99, digits=".3f"),
    Figure(BARE_MISSED, digits=".1f"),
    Figure(SENT, digits=".0f"),
    Figure(LOST, 0.0, digits=".3f"),
    Figure(CPU, digits=".1f"),
    Figure(WAITED, digits=".1f"),
)


@contextmanager
def traffic(
    library: str, size: int, per_second: float, around: dict[str, str]
) -> Iterator[dict[str, float]]:
    """Publish during the block; yield a dict, which gets `sent` and `per_second` at its end."""
    told: dict[str, float] = {}
    if not per_second:
        yield told
        return
    command = [sys.executable, publisher.__file__, library, LOAD, "odometry"]
    with subprocess.Popen(
        [*command, str(size), str(per_second)],
        env=around,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield told
            output, _ = process.communicate(timeout=END_TIMEOUT_S)
            told.update(json.loads(output))
        finally:
            process.kill()


@contextmanager
def indexing(recording: Path | None) -> Iterator[None]:
    """Index a recording in a loop during the block, as the daemon does when it closes one."""
    if recording is None:
        yield
        return
    ended = threading.Event()

    def index() -> None:
        while not ended.is_set():
            child = start(job_command(INDEX, {"recording": str(recording)}))
            while child.wait(0.1) is None and not ended.is_set():
                pass
            child.close()

    thread = threading.Thread(target=index)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def thread_account(pid: int) -> tuple[int, int]:
    """Return the CPU time of all threads, and how long the main one waited for a processor [ns]."""
    accounts = {
        path.parent.name: path.read_text().split()
        for path in Path(f"/proc/{pid}/task").glob("*/schedstat")
    }
    return sum(int(each[0]) for each in accounts.values()), int(accounts[str(pid)][1])


def measure(options: argparse.Namespace, library: str, domain: int) -> Round:
    """Drive and record for `options.seconds`; return the figures from the recorded ticks."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        around = environment(folder, domain)
        with daemon(options.rate, folder, domain) as (pid,):
            with (
                traffic(library, options.size, options.messages, around) as told,
                indexing(options.indexing),
            ):
                time.sleep(WARM_UP_S)
                begun_ns, before = time.monotonic_ns(), thread_account(pid)
                bare_ms, bare_missed = asyncio.run(bare_ticks(options.rate, options.seconds))
                ended_ns, after = time.monotonic_ns(), thread_account(pid)
            time.sleep(1.0)
        (path,) = (each for each in folder.rglob("*.mcap") if each.parent.name != "clips")
        lateness_ms, missed = ticks(path, options.rate, begun_ns, ended_ns)
        recorded = recorded_load(path)
    seconds = (ended_ns - begun_ns) / 1e9
    sent = told.get("sent", 0)
    return {
        P50: percentile(lateness_ms, 50),
        P99: percentile(lateness_ms, 99),
        MAX: lateness_ms[-1],
        MISSED: 60.0 * missed / seconds,
        BARE_P99: percentile(bare_ms, 99),
        BARE_MISSED: 60.0 * bare_missed / seconds,
        SENT: told.get("per_second", 0.0),
        LOST: 100.0 * (sent - recorded) / sent if sent else 0.0,
        CPU: (after[0] - before[0]) / 1e7 / seconds,
        WAITED: (after[1] - before[1]) / 1e6 / seconds,
    }


async def bare_ticks(rate_hz: float, seconds: float) -> tuple[list[float], int]:
    """Tick in this process; return the sorted lateness of the ticks [ms], and the missed ticks."""
    late_ms: list[float] = []
    missed = 0
    async with Ticker(rate_hz) as ticker:
        for _ in range(round(seconds * rate_hz)):
            tick = await anext(ticker)
            first_ms = (tick.t_ns - tick.due_ns) / 1e6
            late_ms += [first_ms + 1000.0 * each / rate_hz for each in range(tick.missed + 1)]
            missed += tick.missed
    return sorted(late_ms), missed


def ticks(path: Path, rate_hz: float, begun_ns: int, ended_ns: int) -> tuple[list[float], int]:
    """Return the sorted lateness [ms] of the ticks in a span of monotonic time, and the missed."""
    period_ns = round(1e9 / rate_hz)
    offsets_ns: list[int] = []
    """For the n-th due tick: its time less n periods."""
    taken = 0
    with Recording(path) as recording:
        for _, entry in read_journal(recording, sys.exit):
            if entry.name != Tick.__name__ or not begun_ns <= entry.t_ns <= ended_ns:
                continue
            skipped = json.loads(entry.data)["missed"] if taken else 0
            first = len(offsets_ns)
            offsets_ns += [
                entry.t_ns - (first + number) * period_ns for number in range(skipped + 1)
            ]
            taken += 1
    punctual_ns = min(offsets_ns)
    late_ms = sorted((each - punctual_ns) / 1e6 for each in offsets_ns)
    return late_ms, len(offsets_ns) - taken


def recorded_load(path: Path) -> int:
    """Return how many messages of the traffic are in the recording."""
    with Recording(path) as recording:
        return sum(topic.message_count for topic in recording.info().topics if topic.name == LOAD)


def percentile(ordered: list[float], percent: int) -> float:
    """Return the percentile of values that are sorted in ascending order."""
    return ordered[min(len(ordered) * percent // 100, len(ordered) - 1)]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rate", type=float, default=100.0, help="of the control tick [Hz]")
    parser.add_argument("--messages", type=float, default=5000.0, help="a second")
    parser.add_argument("--size", type=int, default=724, help="of a message [bytes]")
    parser.add_argument("--seconds", type=float, default=60.0, help="of one round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--indexing", type=Path, metavar="RECORDING")
    options = parser.parse_args()
    rounds = []
    with tempfile.TemporaryDirectory() as scratch, reserved_domain() as domain:
        library = publisher.build(Path(scratch)) if options.messages else ""
        if options.messages and not library:
            print("no C++ compiler: the load comes from Python and is slower", file=sys.stderr)
        for number in range(options.rounds):
            print(f"round {number + 1} of {options.rounds}", file=sys.stderr)
            rounds.append(measure(options, library, domain))
    lines, missed = table(FIGURES, rounds)
    print("| figure | to reach | measured | |\n|---|---|---|---|", *lines, sep="\n")
    print(f"load average {os.getloadavg()[0]:.1f}")
    print(f"{missed} missed." if missed else "All reached.")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
