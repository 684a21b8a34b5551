"""CPU per message of the recorder's writer against other MCAP writers, and what its footer costs.

    python benchmarks/recorder.py [--rounds 5] [--seconds 0.5]

All writers get the same messages in turn, one after the other in each round, so that a noisy
machine is noisy for all; medians over the rounds, CPU time of the whole process. Needs the `dev`
extra (foxglove-sdk).
"""

from __future__ import annotations

import argparse
import math
import random
import statistics
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import foxglove
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from mcap.writer import CompressionType, Writer

from robotctl.recording.account import TopicAccount
from robotctl.recording.buffer import pack
from robotctl.recording.recorder import Compression, Recorder, RecorderOptions, Topic
from robotctl.recording.recording_file import RecordingFile

GID = b"publisher-number"
START_NS = 1_700_000_000_000_000_000
CHUNK_BYTES = 1 << 20
QUEUED_BYTES = 8 << 20


@dataclass(frozen=True)
class Load:
    """Messages of one size; `rate` is about what a writer takes in a second."""

    name: str
    messages: Sequence[bytes]
    rate: int


def loads() -> list[Load]:
    """Twists and odometry as a robot sends them, and images with 4 bits of noise per byte."""
    dice = random.Random(1)
    header = b"\x00\x01\x00\x00"
    twists = [
        header + struct.pack("<6d", math.sin(n / 50), 0, 0, 0, 0, dice.gauss(0, 0.01))
        for n in range(997)
    ]
    odometries = [
        header
        + struct.pack("<iI", n // 50, n % 50 * 20_000_000)
        + b"\x05\x00\x00\x00odom\0\0\0\0\x0a\x00\x00\x00base_link\0\0\0"
        + struct.pack("<7d", n / 500, dice.gauss(0, 0.01), 0, 0, 0, math.sin(n), math.cos(n))
        + struct.pack("<36d", *[0.01 if i % 7 == 0 else 0.0 for i in range(36)])
        + struct.pack("<6d", 0.5, 0, 0, 0, 0, dice.gauss(0, 0.01))
        + struct.pack("<36d4x", *[0.01 if i % 7 == 0 else 0.0 for i in range(36)])
        for n in range(997)
    ]
    noise = dice.randbytes(1_000_000).translate(bytes(value & 15 for value in range(256)))
    images = [noise[shift:] + noise[:shift] for shift in range(0, 7000, 1000)]
    return [
        Load("52 B", twists, 400_000),
        Load("724 B", odometries, 250_000),
        Load("1 MB", images, 300),
    ]


Run = Callable[[Path, Load, int, bool], None]


def run_robotctl(folder: Path, load: Load, count: int, compress: bool) -> None:
    """Ours: always valid, with the loss ledger."""
    options = RecorderOptions(compression=Compression.ZSTD if compress else Compression.NONE)
    recorder = Recorder(folder / "robotctl", options, on_failure=sys.exit)
    write, messages = recorder.write, load.messages
    channel = recorder.add_topic(Topic("/topic", "a/msg/B", "float64 x\n"))
    kinds = len(messages)
    pause = max(QUEUED_BYTES // len(messages[0]) // 2, 1)
    for number in range(1, count + 1):
        stamp = START_NS + number * 1000
        write(channel, messages[number % kinds], stamp, stamp, number, GID)
        if number % pause == 0:  # no robot is faster than its disk for long
            while recorder.stats().queued > pause:
                time.sleep(0.001)
    stats = recorder.close()
    assert (stats.written, stats.dropped) == (count, 0)


def run_mcap(folder: Path, load: Load, count: int, compress: bool) -> None:
    """The mcap package."""
    with (folder / "mcap.mcap").open("wb") as stream:
        kind = CompressionType.ZSTD if compress else CompressionType.NONE
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=kind)
        writer.start(profile="ros2", library="benchmark")
        schema = writer.register_schema("a/msg/B", "ros2msg", b"float64 x\n")
        channel = writer.register_channel("/topic", "cdr", schema)
        add, messages = writer.add_message, load.messages
        kinds = len(messages)
        for number in range(1, count + 1):
            stamp = START_NS + number * 1000
            add(channel, stamp, messages[number % kinds], stamp, number)
        writer.finish()


def run_foxglove(folder: Path, load: Load, count: int, compress: bool) -> None:
    """foxglove-sdk, in Rust, at the same level of compression."""
    context = foxglove.Context()
    options = MCAPWriteOptions(
        compression=MCAPCompression.Zstd if compress else None,
        profile="ros2",
        chunk_size=CHUNK_BYTES,
        compression_level=1,
        compression_threads=0,
    )
    writer = foxglove.open_mcap(folder / "foxglove.mcap", context=context, writer_options=options)
    schema = foxglove.Schema(name="a/msg/B", encoding="ros2msg", data=b"float64 x\n")
    channel = foxglove.Channel("/topic", schema=schema, message_encoding="cdr", context=context)
    log, messages = channel.log, load.messages
    kinds = len(messages)
    for number in range(1, count + 1):
        log(messages[number % kinds], log_time=START_NS + number * 1000)
    writer.close()


def run_plain(folder: Path, load: Load, count: int, compress: bool) -> None:
    """No format at all: the data, written."""
    del compress
    with (folder / "plain").open("wb") as stream:
        write, messages = stream.write, load.messages
        kinds = len(messages)
        for number in range(1, count + 1):
            write(messages[number % kinds])


WRITERS: dict[str, Run] = {
    "robotctl": run_robotctl,
    "mcap": run_mcap,
    "foxglove-sdk": run_foxglove,
    "plain write": run_plain,
}
TARGETS = {
    ("52 B", "mcap"): 0.25,
    ("52 B", "foxglove-sdk"): 0.9,
    ("724 B", "mcap"): 0.30,
    ("724 B", "foxglove-sdk"): 0.9,
    ("1 MB", "foxglove-sdk"): 1.05,
}
"""Ratio of CPU time to reach, ours to theirs, zstd."""


def compare(load: Load, rounds: int, seconds: float, compress: bool, scratch: Path) -> None:
    """Print CPU us per message of each writer, and our ratio to it."""
    count = max(int(load.rate * seconds), 10)
    spent: dict[str, list[float]] = {name: [] for name in WRITERS}
    for _ in range(rounds):
        for name, run in WRITERS.items():
            with tempfile.TemporaryDirectory(dir=scratch) as folder:
                begin = time.process_time()
                run(Path(folder), load, count, compress)
                spent[name].append((time.process_time() - begin) / count * 1e6)
    medians = {name: statistics.median(values) for name, values in spent.items()}
    for name, median in medians.items():
        ratio = medians["robotctl"] / median
        target = TARGETS.get((load.name, name)) if compress else None
        verdict = "" if target is None else f"  to reach: <= {target}"
        print(
            f"{load.name:>6}  {'zstd' if compress else 'none'}  {name:12}"
            f" {median:9.2f} us/message   ratio {ratio:5.2f}{verdict}"
        )


def footer(scratch: Path) -> None:
    """Print what the rolling footer costs in a file of the default length: 10 minutes, 30 topics.

    Three messages a second of each topic: then the footer is largest beside the data.
    """
    options = RecorderOptions()
    commits = int(options.split_s / options.flush_s)
    topics = 30
    with tempfile.TemporaryDirectory(dir=scratch) as name:
        folder = Path(name)
        accounts = [TopicAccount(Topic(f"/topic{n}", "a/msg/B", "x\n")) for n in range(topics)]
        file = RecordingFile(folder / "file.mcap", options, {}, accounts)
        taken = pack([(channel, bytes(52), 1, 1, 1) for channel in range(topics)])
        begin = time.process_time()
        for _ in range(commits):
            file.write(taken)
        spent = time.process_time() - begin
        recorded = commits * topics * (31 + 52)
        written = file.size + file.trailer_bytes
        file.finish()
    print(f"footer  {spent / options.split_s:.2%} of one core   to reach: <= 2 %")
    print(
        f"        {written / recorded:.1f} bytes written per byte recorded"
        f" ({written / options.split_s / 1e6:.2f} MB/s on average)"
    )


def memory(scratch: Path) -> None:
    """Print by how much the process grows while it records."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        load = loads()[0]
        for number in range(8):
            run_robotctl(Path(folder) / str(number), load, 500_000, compress=True)
            if number == 2:  # the queue has had its bursts
                before = resident_mb()
        print(f"memory  {resident_mb() - before:+.1f} MB after another 2.5 million messages")


def resident_mb() -> float:
    """Resident memory of this process [MB]."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1000
    raise LookupError("no VmRSS in /proc/self/status")


def main() -> None:
    """Run it all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.5, help="of each writer in each round")
    parser.add_argument("--scratch", type=Path, default=None, help="a folder on the disk to use")
    arguments = parser.parse_args()
    memory(arguments.scratch)
    footer(arguments.scratch)
    for load in loads():
        for compress in (True, False):
            compare(load, arguments.rounds, arguments.seconds, compress, arguments.scratch)


if __name__ == "__main__":
    main()
