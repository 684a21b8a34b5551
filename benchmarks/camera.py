"""A recording with a camera: what evidence chunks cost, and how little of it a check reads.

    python benchmarks/camera.py                    about 1 GB, a minute
    python benchmarks/camera.py --gigabytes 10     as the promise says; needs the room on the disk

Journal, commands and odometry of a simulated drive at 50 Hz are recorded beside a camera, by the
recorder itself, once without evidence chunks and once with them. The bytes that a check reads are
counted at the source. CPU time is that of the whole process while it records.
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from pathlib import Path

from robotctl.recording import Compression, Recorder, RecorderOptions, Topic
from robotctl.recording.read.source import LocalSource
from robotctl.rerun.check import check_recording
from robotctl.rerun.check_report import Verdict
from robotctl.testing.drives import GID, JOURNAL, ODOMETRY, TWIST, drive, record

CAMERA = Topic("/camera", "sensor_msgs/msg/CompressedImage")
EVIDENCE = frozenset({JOURNAL.name, TWIST.name, ODOMETRY.name})
FRAME_NS = 33_333_333
MAX_QUEUED_BYTES = 60 << 20


class Camera:
    """Records images of `size` bytes at 30 Hz, which zstd cannot compress."""

    def __init__(self, size: int) -> None:
        dice = random.Random(1)
        self._images = [dice.randbytes(size) for _ in range(16)]
        self._due_ns = 0
        self.count = 0

    def __call__(self, recorder: Recorder, time_ns: int) -> None:
        """Record the images that are due."""
        if time_ns < self._due_ns:
            return
        self._due_ns = max(self._due_ns, time_ns) + FRAME_NS
        image = self._images[self.count % len(self._images)]
        recorder.write(recorder.add_topic(CAMERA), image, time_ns, time_ns, 0, GID)
        self.count += 1
        while recorder.stats().queued * len(image) > MAX_QUEUED_BYTES:
            time.sleep(0.001)


class CountingSource(LocalSource):
    """A file whose read bytes are counted."""

    read_bytes = 0

    def read(self, offset: int, length: int) -> bytes:
        """Read, and count."""
        data = super().read(offset, length)
        self.read_bytes += len(data)
        return data


def measure(folder: Path, size: int, seconds: float, evidence: frozenset[str]) -> tuple[int, float]:
    """Record one drive and check it; return the bytes of the file and print a row."""
    camera = Camera(size)
    options = RecorderOptions(
        compression=Compression.ZSTD, evidence=evidence, split_bytes=1 << 60, split_s=1e9
    )
    written = drive(seconds, snapshots_s=[10.0 * n for n in range(int(seconds / 10) + 1)])
    began = time.process_time()
    record(folder, written, options=options, beside=camera)
    took_s = time.process_time() - began
    (file,) = folder.glob("*.mcap")
    source = CountingSource(file)
    report = check_recording(file, source=source)
    assert report.verdict is Verdict.SAME, report
    total = file.stat().st_size
    share = source.read_bytes / total
    print(
        f"{len(evidence):>8} {size / 1e3:>7.0f} kB {total / 1e6:>9.1f} MB {took_s:>7.2f} s"
        f" {source.read_bytes / 1e6:>8.2f} MB {share:>8.2%}"
    )
    return total, took_s


def main() -> None:
    """Measure with images that share chunks, and with images that have their own."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gigabytes", type=float, default=1.0)
    given = parser.parse_args()
    print("evidence   image      file         CPU      read     share")
    for size in (100_000, 400_000, 1_000_000):
        seconds = given.gigabytes * 1e9 / 3 / size / 30
        for evidence in (frozenset[str](), EVIDENCE):
            with tempfile.TemporaryDirectory() as folder:
                measure(Path(folder) / "run", size, seconds, evidence)


if __name__ == "__main__":
    main()
