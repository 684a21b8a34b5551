"""`robotctl replay --check`: how much faster than real time, on how many cores, in what memory.

    python benchmarks/check.py                       5 rounds, less than two minutes
    python benchmarks/check.py --rounds 1 --gigabyte 1   memory over a file of 1 GB: minutes

The recordings are made here, by the recorder's own writer, sealed: journal, velocity commands,
odometry, battery and status of a simulated drive at 100 Hz, a snapshot every 10 s. In one the robot
is MOVING all the time, which costs most; in the other it stands. Times are CPU time of the process,
so that other processes count little; only many recordings are timed by wall clock. The kernel's
steps alone are measured on the same events: they are the least that a check costs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from recording.figures import Figure, Round, table
from recording.heard_drive import record_drive

from robotctl.check.journal import read_event, read_snapshot
from robotctl.check.report import Verdict
from robotctl.check.run import check_recording, check_recordings
from robotctl.recording import Compression, Recording
from robotctl.recording.format.journal import EntryKind
from robotctl.recording.read.journal_reader import read_journal

RATE_HZ = 100.0
SECONDS = 60.0
FILES = 8
BYTES_PER_S = 138_000
"""The size of one second of such a recording, not compressed."""

MEMORY = """
import sys
from pathlib import Path
from robotctl.check.run import check_recording
report = check_recording(Path(sys.argv[1]))
assert report.verdict == "same", report
status = Path("/proc/self/status").read_text()
print(int(status.split("VmHWM:")[1].split()[0]) / 1024)
"""


def make(
    folder: Path, seconds: float, *, moving: bool, compression: Compression = Compression.ZSTD
) -> Path:
    """Record `seconds` of a drive in one file; return its folder."""
    record_drive(folder, seconds, rate_hz=RATE_HZ, moving=moving, compression=compression)
    return folder


def times_real_time(path: Path) -> float:
    """Check a recording; return recorded seconds per second of CPU time."""
    began = time.process_time()
    report = check_recording(path)
    took_s = time.process_time() - began
    assert report.verdict is Verdict.SAME, report
    return report.duration_s / took_s


def decided_s(path: Path) -> Callable[[], float]:
    """Return a function that returns the CPU time [s] of the kernel's steps on these events."""
    with Recording(path) as recording:
        entries = [each.entry for each in read_journal(recording, print)]
    snapshot = next(entry for entry in entries if entry.kind is EntryKind.SNAPSHOT)
    events = [read_event(entry) for entry in entries if entry.kind is EntryKind.EVENT]

    def run() -> float:
        step = read_snapshot(snapshot).kernel().step
        began = time.process_time()
        for event in events:
            step(event)
        return time.process_time() - began

    return run


def many(paths: list[Path]) -> float:
    """Check all recordings; return recorded seconds per second of wall time."""
    began = time.perf_counter()
    reports = check_recordings(paths)
    took_s = time.perf_counter() - began
    assert all(report["verdict"] == "same" for report in reports), reports
    return float(sum(report["duration_s"] for report in reports) / took_s)


def peak_mb(path: Path) -> float:
    """Return the peak memory of a process that checks the recording [MB]."""
    ran = subprocess.run(
        [sys.executable, "-c", MEMORY, str(path)], stdout=subprocess.PIPE, check=True
    )
    return float(ran.stdout)


def one_round(
    moving: Path, standing: Path, copies: list[Path], large: Path, kernel: Callable[[], float]
) -> Round:
    """Measure every figure once."""
    alone = times_real_time(moving)
    kernel_s = min(kernel() for _ in range(3))
    together = many(copies)
    small_mb, large_mb = peak_mb(moving), peak_mb(large)
    return {
        MOVING: alone,
        KERNEL: SECONDS / kernel_s,
        REST: SECONDS / alone / kernel_s - 1.0,
        STANDING: times_real_time(standing),
        f"{FILES} recordings at once, times real time": together,
        "of it per core that there is": together / len(os.sched_getaffinity(0)),
        "peak memory, 1 minute [MB]": small_mb,
        "peak memory, the large file beyond that [MB]": large_mb - small_mb,
    }


MOVING = "MOVING at 100 Hz, times real time per core"
KERNEL = "the kernel's own steps alone, times real time per core"
REST = "CPU of everything else / of the kernel's own steps"
STANDING = "standing at 100 Hz, times real time per core"

FIGURES = (
    Figure(MOVING, 110.0, at_least=True, digits=".0f"),
    Figure(KERNEL, digits=".0f"),
    Figure(REST, digits=".2f"),
    Figure(STANDING, 110.0, at_least=True, digits=".0f"),
    Figure(f"{FILES} recordings at once, times real time", digits=".0f"),
    Figure("of it per core that there is", digits=".0f"),
    Figure("peak memory, 1 minute [MB]", digits=".1f"),
    Figure("peak memory, the large file beyond that [MB]", 5.0, digits=".1f"),
)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--gigabyte", type=float, default=0.05, help="size of the large file")
    arguments = parser.parse_args()
    rounds = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        moving = make(folder / "moving", SECONDS, moving=True)
        standing = make(folder / "standing", SECONDS, moving=False)
        large_s = arguments.gigabyte * 1e9 / BYTES_PER_S
        large = make(folder / "large", large_s, moving=True, compression=Compression.NONE)
        size = sum(file.stat().st_size for file in large.glob("*.mcap"))
        kernel = decided_s(moving)
        print(f"the large file: {size / 1e6:.0f} MB, {large_s:.0f} s", file=sys.stderr)
        for number in range(1, arguments.rounds + 1):
            load = os.getloadavg()[0]
            print(f"round {number} of {arguments.rounds}, load {load:.1f}", file=sys.stderr)
            copies = [moving, standing] * (FILES // 2)
            rounds.append(one_round(moving, standing, copies, large, kernel))
    lines, missed = table(FIGURES, rounds)
    print("| figure | to reach | measured | |\n|---|---|---|---|")
    print(*lines, sep="\n")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
