"""Copies of recordings to a folder and to a bucket: speed, CPU time and requests.

    python benchmarks/collect.py
    python benchmarks/collect.py --recordings 5 --megabytes 200 --rounds 1

A month of short drives and some long ones is copied by `robotctl sync`, by `cp` and by a script
that hands each file to obstore, which is what `sync` does without hashes, names and manifests. The
bucket is moto's S3 server in a process of its own, which takes most of the time. In each round
every contender has its turn; shown are medians, and the lowest and highest. CPU is that of the
process that copies.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from robotctl.testing.drives import drive, record

ROBOTCTL = str(Path(sys.executable).with_name("robotctl"))

SERVER = """
from moto.server import ThreadedMotoServer
from urllib.request import Request, urlopen
import logging, sys
logging.getLogger("werkzeug").setLevel(logging.ERROR)
server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
server.start()
host, port = server.get_host_and_port()
urlopen(Request(f"http://{host}:{port}/robots", method="PUT"))
print(f"http://{host}:{port}", flush=True)
sys.stdin.read()
"""

PLAIN = """
import sys, obstore
from pathlib import Path
from obstore.store import from_url
store = from_url("s3://robots", client_options={"allow_http": True})
for path in Path(sys.argv[1]).rglob("*"):
    if path.is_file():
        obstore.put(store, f"{sys.argv[2]}/{path.name}", path)
"""


@dataclass(frozen=True)
class Cost:
    """What one process took."""

    wall_s: float
    cpu_s: float


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--megabytes", type=int, default=30, help="of each tenth recording")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    with TemporaryDirectory(prefix="robotctl-collect-") as made, s3_server() as endpoint:
        os.environ |= {
            "AWS_ENDPOINT_URL": endpoint,
            "AWS_ALLOW_HTTP": "true",
            "AWS_ACCESS_KEY_ID": "any",
            "AWS_SECRET_ACCESS_KEY": "any",
            "AWS_REGION": "us-east-1",
        }
        month = Path(made, "month")
        make(month, given.recordings, given.megabytes)
        compare(Path(made), month, given.rounds)


def make(month: Path, count: int, megabytes: int) -> None:
    """Make recordings; each tenth is a long one."""
    one = record(month.with_name("robot_20260101_000000"), drive(3.0))
    for number in range(count):
        folder = month / f"robot_20260101_{number:06}"
        folder.mkdir(parents=True)
        for path in one.iterdir():
            copied = folder / path.name.replace(one.name, folder.name)
            copied.write_bytes(path.read_bytes() + folder.name.encode())
            if number % 10 == 0 and copied.suffix == ".mcap":
                with copied.open("ab") as file:
                    file.write(os.urandom(megabytes << 20))
            os.utime(copied, (1.7e9, 1.7e9))


def compare(work: Path, month: Path, rounds: int) -> None:
    """Measure all contenders in turn, and print the table."""
    size_mb = sum(path.stat().st_size for path in month.rglob("*") if path.is_file()) / 1e6
    files = sum(path.is_file() for path in month.rglob("*"))
    costs: dict[str, list[Cost]] = {}
    for number in range(rounds):
        target, url = work / f"copy-{number}", f"s3://robots/copy-{number}"
        sync = (ROBOTCTL, "sync", "--recordings", str(month))
        plain = (sys.executable, "-c", PLAIN, str(month), f"plain-{number}")
        turns: dict[str, Sequence[str]] = {
            "cp -r": ("cp", "-r", str(month), str(work / "cp")),
            "sync to a folder": (*sync, str(target)),
            "the same again": (*sync, str(target)),
            "obstore.put": plain,
            "sync to a bucket": (*sync, url),
            "the same once more": (*sync, url),
        }
        for name, command in turns.items():
            if name in ("sync to a folder", "sync to a bucket"):
                shutil.rmtree(month / ".sync", ignore_errors=True)
            costs.setdefault(name, []).append(cost_of(command))
        shutil.rmtree(work / "cp")
        shutil.rmtree(target)
    print(f"{files} files, {size_mb:.0f} MB; load {os.getloadavg()[0]:.0f}\n")
    print("| | MB/s | CPU [s] | CPU for a GB [s] |\n|---|---|---|---|")
    for name, each in costs.items():
        speed = spread([size_mb / cost.wall_s for cost in each], 0)
        cpu = spread([cost.cpu_s for cost in each], 2)
        by_size = median(cost.cpu_s for cost in each) / size_mb * 1000
        print(f"| {name} | {speed} | {cpu} | {by_size:.1f} |")


def cost_of(command: Sequence[str]) -> Cost:
    """Run a command to its end, and return what it took."""
    begun_s = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(command[:3])} ended with {process.returncode}")
    return Cost(time.monotonic() - begun_s, used.ru_utime + used.ru_stime)


def spread(values: list[float], digits: int) -> str:
    """Return the median, and the lowest and highest."""
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return f"{median(values):.{digits}f} [{low} .. {high}]"


@contextmanager
def s3_server() -> Iterator[str]:
    """Serve S3 on localhost with an empty bucket `robots`; yield the endpoint."""
    command = [sys.executable, "-c", SERVER]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        try:
            yield server.stdout.readline().strip()
        finally:
            server.kill()


if __name__ == "__main__":
    main()
