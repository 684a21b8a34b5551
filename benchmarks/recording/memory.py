"""Memory of the recorder: bounded by its queue when the disk is stuck, and flat over time."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from recording.figures import Figure
from recording.live import SMALL, Bench, Load
from recording.subject import resident_mb

from robotctl.recording import Recorder, RecorderOptions, Topic
from robotctl.recording.format.disk import Buffer, DiskFile

BOUNDED = "memory with a stuck disk / configured queue, 52 B"
BOUNDED_LIMIT = 1.05
FLOOD = 3
"""How many times the size of the queue is written while the disk is stuck."""

SOAK_S = 600.0
SOAK_SETTLED_S = 60.0
SOAK_HZ = 5000.0
SOAK_SAMPLE_S = 5.0
SOAK = "growth of memory over 10 minutes at 5k msg/s [MB]"
SOAK_RESIDENT = "memory after 10 minutes at 5k msg/s [MB]"
SOAK_LIMIT_MB = 1.0


class StuckFile(DiskFile):
    """A file that accepts one write, and blocks all others until `free` is set."""

    free = threading.Event()
    _writes = 0

    def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
        if self._writes:
            self.free.wait()
        self._writes += 1
        super().write_at(parts, offset)


def figures() -> Iterator[Figure]:
    yield Figure(BOUNDED, BOUNDED_LIMIT)


def measure(bench: Bench) -> Iterator[tuple[str, float]]:
    """Run `stuck` in a new process, whose memory nothing else has used."""
    command = [sys.executable, "-m", "recording.memory", str(bench.scratch)]
    folder = Path(__file__).parent.parent
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=folder)
    yield BOUNDED, float(output.stdout)


def stuck(scratch: Path) -> float:
    """Return by how many sizes of the configured queue this process grows with a stuck disk."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        options = RecorderOptions(open_file=StuckFile)
        recorder = Recorder(Path(folder) / "stuck", options, on_failure=sys.exit)
        channel = recorder.add_topic(Topic("/topic", "a/msg/B", "float64 x\n"))
        before = resident_mb()
        data = bytes(52)
        for number in range(1, FLOOD * options.memory_bytes // len(data)):
            recorder.write(channel, data, number, number, number, b"publisher-number")
        grown = resident_mb() - before
        assert recorder.stats().dropped, "the queue took everything: the disk was not stuck"
        StuckFile.free.set()
        recorder.close()
    return grown * 1e6 / options.memory_bytes


def soak_figures() -> Iterator[Figure]:
    yield Figure(SOAK, SOAK_LIMIT_MB)
    yield Figure(SOAK_RESIDENT, digits=".0f")


def soak(bench: Bench) -> Iterator[tuple[str, float]]:
    """Compare the memory in the second minute with that in the last one, under traffic."""
    load = Load(*SMALL, SOAK_HZ)
    samples = []
    with bench.running("zstd", load, SOAK_S) as (taker, _):
        end = time.monotonic() + SOAK_S
        while time.monotonic() < end:
            time.sleep(SOAK_SAMPLE_S)
            samples.append(resident_mb(taker.pid))
    minute = round(60 / SOAK_SAMPLE_S)
    settled = samples[round(SOAK_SETTLED_S / SOAK_SAMPLE_S) :]
    yield SOAK, statistics.median(settled[-minute:]) - statistics.median(settled[:minute])
    yield SOAK_RESIDENT, samples[-1]


if __name__ == "__main__":
    print(stuck(Path(sys.argv[1])))
