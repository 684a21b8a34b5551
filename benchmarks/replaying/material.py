"""The recordings to play: a topic at a steady rate, and a simulated drive."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from robotctl.recording import Compression, Recorder, RecorderOptions, Topic

ROBOTCTL = [sys.executable, "-P", "-c", "from robotctl.cli.app import main; main()"]
ODOMETRY = "nav_msgs/msg/Odometry"
ODOMETRY_BYTES = 724
QOS = """\
- history: keep_last
  depth: 10
  reliability: reliable
  durability: volatile
"""
START_NS = 1_700_000_000_000_000_000


def write_steady(folder: Path, rate_hz: float, count: int) -> Path:
    """Record 724 B messages at a steady rate, not compressed; return the folder."""
    options = RecorderOptions(split_s=1e9, split_bytes=1 << 40, compression=Compression.NONE)
    recorder = Recorder(folder, options, on_failure=print)
    channel = recorder.add_topic(Topic("/odom", ODOMETRY, "", "", QOS))
    data = odometry()
    for number in range(count):
        at_ns = START_NS + round(number / rate_hz * 1e9)
        recorder.write(channel, data, at_ns, at_ns, number, b"publisher-number")
        if number % 20_000 == 0:
            time.sleep(0.05)  # the writer's thread keeps up, and nothing is dropped
    recorder.close()
    return folder


def odometry() -> bytes:
    """Return a serialized message of ODOMETRY_BYTES."""
    names = struct.pack("<I8sI12s", 5, b"odom", 10, b"base_link")
    head = b"\0\1\0\0" + struct.pack("<iI", 1, 2) + names
    return (head + bytes(ODOMETRY_BYTES))[:ODOMETRY_BYTES]


@contextmanager
def a_drive(scratch: Path) -> Iterator[Path]:
    """Yield the recording of a new `robotctl demo`."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        command = [*ROBOTCTL, "demo", "--json", "--recordings", folder]
        ran = subprocess.run(command, capture_output=True, text=True, check=True)
        yield Path(json.loads(ran.stdout)["recording"])
