"""The live view: message in to frame out, CPU per message, memory with stalled viewers.

    python benchmarks/view.py

A server publishes at a rate to 1, 10 and 100 viewers: that of `robotctl view`, and that of the
Foxglove SDK alone, by turns. The delay is from the call that publishes to the receipt of the frame
in another process, at one of the viewers; the others drain. CPU is that of the server's process,
divided by messages, and by frames (messages times viewers).

The second part: 100 viewers that take nothing. What the server's process grows by, and the target
of 64 MB.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
from pathlib import Path
from statistics import median
from typing import Any

from viewing.clients import Client, drain, latencies_of

VIEWERS = (1, 10, 100)
RATE_HZ = 200.0
BYTES = 700
"""An odometry message has as many."""

STALLED_MB = 64.0


def run(which: str, viewers: int, seconds: float, *, size: int, stalled: bool) -> dict[str, Any]:
    """Measure one server with some viewers."""
    command = [sys.executable, "-m", "viewing.servers", which]
    server = subprocess.Popen(
        [*command, str(RATE_HZ), str(seconds), str(size)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parent,
    )
    assert server.stdin is not None
    assert server.stdout is not None
    with server:
        port = int(server.stdout.readline())
        clients = [Client(port) for _ in range(viewers)]
        ended = threading.Event()
        delays: list[float] = []
        threads = []
        if not stalled:
            first, *others = clients
            threads = [threading.Thread(target=latencies_of, args=(first, ended, delays))]
            threads += [threading.Thread(target=drain, args=(others, ended))] if others else []
        for thread in threads:
            thread.start()
        server.stdin.write("\n")
        server.stdin.flush()
        result: dict[str, Any] = json.loads(server.stdout.readline())
        ended.set()
        for thread in threads:
            thread.join()
        for client in clients:
            client.socket.close()
    delays.sort()
    result["received"] = len(delays)
    if delays:
        result["p50_ms"] = delays[len(delays) // 2]
        result["p99_ms"] = delays[len(delays) * 99 // 100]
    result["us_per_message"] = 1e6 * result["cpu_s"] / result["sent"]
    result["grown_mb"] = (result["rss_after"] - result["rss_before"]) / 1e6
    return result


def spread(values: list[float], form: str) -> str:
    """Return median, lowest and highest."""
    return f"{median(values):{form}} [{min(values):{form}} .. {max(values):{form}}]"


def main() -> int:
    """Print the tables; return 1 where the target is missed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0)
    options = parser.parse_args()
    print("| viewers | server | p50 [ms] | p99 [ms] | CPU a message [us] | a frame [us] | lost |")
    print("|---|---|---|---|---|---|---|")
    for viewers in VIEWERS:
        found: dict[str, list[dict[str, Any]]] = {"ours": [], "sdk": []}
        for _ in range(options.rounds):
            for which, results in found.items():
                results.append(run(which, viewers, options.seconds, size=BYTES, stalled=False))
        for which, results in found.items():
            cells = [spread([each[key] for each in results], ".2f") for key in ("p50_ms", "p99_ms")]
            cpu = [each["us_per_message"] for each in results]
            cells += [spread(cpu, ".0f"), spread([each / viewers for each in cpu], ".1f")]
            lost = sum(each["sent"] - each["received"] for each in results)
            print(f"| {viewers} | {which} | {' | '.join(cells)} | {lost} |", flush=True)
    print("\n| 100 stalled viewers | server | process grown [MB] | CPU a message [us] |")
    print("|---|---|---|---|")
    grown = 0.0
    for size in (BYTES, 100_000):
        for which in ("ours", "sdk"):
            result = run(which, 100, options.seconds, size=size, stalled=True)
            mb, cpu_us = result["grown_mb"], result["us_per_message"]
            grown = max(grown, mb if which == "ours" else 0.0)
            print(f"| messages of {size} bytes | {which} | {mb:.1f} | {cpu_us:.0f} |", flush=True)
    reached = grown <= STALLED_MB
    verdict = "reached" if reached else "MISSED"
    print(f"\n{verdict}: at most {STALLED_MB:g} MB with 100 stalled viewers")
    return not reached


if __name__ == "__main__":
    sys.exit(main())
