"""CPU of the recorder's writer against other MCAP writers, all given the same messages."""

from __future__ import annotations

import math
import random
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import foxglove
from foxglove.mcap import MCAPCompression, MCAPWriteOptions
from mcap.writer import CompressionType, Writer
from recording.figures import Figure

from robotctl.recording import Compression, Recorder, RecorderOptions, Topic

GID = b"publisher-number"
START_NS = 1_700_000_000_000_000_000
CHUNK_BYTES = 1 << 20
QUEUED_BYTES = 8 << 20


@dataclass(frozen=True)
class Load:
    """Messages of one size, which are repeated until `count` are written: about half a second."""

    name: str
    messages: Sequence[bytes]
    count: int


def loads() -> list[Load]:
    """Return twists and odometry of a moving robot, and images with 4 bits of noise per byte."""
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
        Load("52 B", twists, 200_000),
        Load("724 B", odometries, 125_000),
        Load("1 MB", images, 150),
    ]


def write_robotctl(folder: Path, load: Load, count: int, compress: bool) -> None:
    """Write with robotctl's recorder, with its loss ledger; the file is always valid."""
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


def write_mcap(folder: Path, load: Load, count: int, compress: bool) -> None:
    """Write with the mcap package."""
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


def write_foxglove(folder: Path, load: Load, count: int, compress: bool) -> None:
    """Write with foxglove-sdk, in Rust, at the same level of compression."""
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


def write_plain(folder: Path, load: Load, count: int, compress: bool) -> None:
    """Write only the data, without any format."""
    del compress
    with (folder / "plain").open("wb") as stream:
        write, messages = stream.write, load.messages
        kinds = len(messages)
        for number in range(1, count + 1):
            write(messages[number % kinds])


WRITERS: dict[str, Callable[[Path, Load, int, bool], None]] = {
    "robotctl": write_robotctl,
    "mcap": write_mcap,
    "foxglove-sdk": write_foxglove,
    "plain write": write_plain,
}
LIMITS = {
    ("52 B", "mcap"): 0.25,
    ("724 B", "mcap"): 0.30,
    ("52 B", "foxglove-sdk"): 0.9,
    ("724 B", "foxglove-sdk"): 0.9,
    ("1 MB", "foxglove-sdk"): 1.05,
}


def ratio_name(load: str, writer: str) -> str:
    return f"writer CPU / {writer}, {load}, zstd"


def figures() -> Iterator[Figure]:
    for (load, writer), limit in LIMITS.items():
        yield Figure(ratio_name(load, writer), limit)
    for load in ("52 B", "724 B", "1 MB"):
        for compression in ("none", "zstd"):
            yield Figure(f"writer, {load}, {compression} [us per message]")


def measure(scratch: Path) -> Iterator[tuple[str, float]]:
    """Measure the CPU per message of each writer; yield robotctl's, and its ratio to others.

    Each writer runs twice, in the order and in reverse, so that none always follows the same one.
    """
    for load in loads():
        for compression in ("none", "zstd"):
            spent = dict.fromkeys(WRITERS, 0.0)
            for name in (*WRITERS, *reversed(WRITERS)):
                with tempfile.TemporaryDirectory(dir=scratch) as folder:
                    begun = time.process_time()
                    WRITERS[name](Path(folder), load, load.count, compression == "zstd")
                    spent[name] += (time.process_time() - begun) / load.count / 2 * 1e6
            yield f"writer, {load.name}, {compression} [us per message]", spent["robotctl"]
            if compression == "zstd":
                for name in ("mcap", "foxglove-sdk"):
                    yield ratio_name(load.name, name), spent["robotctl"] / spent[name]
