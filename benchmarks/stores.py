"""A check of a recording in a store beside a check of the same files here: requests, bytes, time.

    python benchmarks/stores.py                    about 1 GB
    python benchmarks/stores.py --gigabytes 10     needs the room on the disk

A drive beside a camera is recorded, with evidence chunks. A server of S3 in a process of its own,
written in Python, gives it by ranges, and waits before each answer as a network would. In each
round every contender has its turn; CPU is that of the command with its processes.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests.support

from camera import EVIDENCE, Camera

from robotctl.recording import RecorderOptions
from robotctl.testing.drives import drive, record
from tests.support.s3_server import environment

ROBOTCTL = str(Path(sys.executable).with_name("robotctl"))

IMAGE_BYTES = 300_000
BYTES_PER_SECOND = 25 * IMAGE_BYTES  # an image goes with each second tick

SERVER = """
import sys
from pathlib import Path
from tests.support.faulty_bucket import StoredFile, faulty_bucket
with faulty_bucket() as bucket:
    folder = Path(sys.argv[1])
    for path in folder.iterdir():
        bucket.objects[f"{folder.name}/{path.name}"] = StoredFile(path)
    bucket.latency_s = float(sys.argv[2])
    print(bucket.endpoint, flush=True)
    for _ in sys.stdin:
        print(bucket.requests, bucket.sent_bytes, flush=True)
        bucket.requests = bucket.sent_bytes = 0
"""


def main() -> None:
    """Record, measure, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--gigabytes", type=float, default=1.0)
    parser.add_argument("--latency-ms", type=float, nargs="*", default=[0.0, 20.0])
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="robotctl-stores-") as made:
        folder = Path(made, "robot_20260101_120000")
        options = RecorderOptions(evidence=EVIDENCE, memory_bytes=1 << 30)
        seconds = given.gigabytes * 1e9 / BYTES_PER_SECOND
        snapshots_s = tuple(60.0 * minute for minute in range(int(seconds / 60) + 1))
        camera = Camera(IMAGE_BYTES)
        record(folder, drive(seconds, snapshots_s=snapshots_s), options=options, beside=camera)
        compare(folder, given.latency_ms, given.rounds)


def compare(folder: Path, latencies_ms: list[float], rounds: int) -> None:
    """Measure all contenders in turn, and print the table."""
    size = sum(path.stat().st_size for path in folder.iterdir())
    print(f"{size / 1e9:.1f} GB; load {os.getloadavg()[0]:.0f}\n")
    print("| | requests | MB | share | wall [s] | CPU [s] |\n|---|---|---|---|---|---|")
    rows: dict[str, list[tuple[int, int, float, float]]] = {}
    for _ in range(rounds):
        rows.setdefault("here", []).append((0, 0, *cost_of(str(folder), {})))
        for latency_ms in latencies_ms:
            with serving(folder, latency_ms / 1000) as server:
                used = cost_of(f"s3://robots/{folder.name}", environment(server.endpoint))
                rows.setdefault(f"{latency_ms:g} ms", []).append((*server.counts(), *used))
    for name, each in rows.items():
        requests, sent, _, _ = each[-1]
        wall, cpu = ([row[column] for row in each] for column in (2, 3))
        print(
            f"| {name} | {requests} | {sent / 1e6:.1f} | {sent / size:.2%} "
            f"| {spread(wall)} | {spread(cpu)} |"
        )


def cost_of(recording: str, variables: dict[str, str]) -> tuple[float, float]:
    """Check a recording, and return wall and CPU time [s]."""
    begun_s = time.monotonic()
    process = subprocess.Popen(
        [ROBOTCTL, "replay", "--check", recording],
        stdout=subprocess.DEVNULL,
        env=os.environ | variables,
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"the check of {recording} ended with {process.returncode}")
    return time.monotonic() - begun_s, used.ru_utime + used.ru_stime


class Server:
    """The process that serves."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.endpoint = self._line()

    def counts(self) -> tuple[int, int]:
        """Return requests and bytes since the last call."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        requests, sent = map(int, self._line().split())
        return requests, sent

    def _line(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()


@contextmanager
def serving(folder: Path, latency_s: float) -> Iterator[Server]:
    """Serve a folder until the end of the block."""
    with subprocess.Popen(
        [sys.executable, "-c", SERVER, str(folder), str(latency_s)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[1],
    ) as process:
        try:
            yield Server(process)
        finally:
            process.kill()


def spread(values: list[float]) -> str:
    """Return the median, and the lowest and highest."""
    return f"{median(values):.1f} [{min(values):.1f} .. {max(values):.1f}]"


if __name__ == "__main__":
    main()
