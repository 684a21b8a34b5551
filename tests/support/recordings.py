"""Writes recordings in tests, and reads them with the mcap package."""

from __future__ import annotations

import random
import resource
import struct
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import forkserver, get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Any

import yaml
from mcap.reader import SeekingReader, make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import Writer

from robotctl.recording import Compression, Recorder, RecorderOptions, RecorderStats, read_messages
from robotctl.recording import Message as RecordedMessage
from robotctl.recording.format.seal_records import Link, Opening, SealOfFile
from robotctl.recording.seal import SEED_BYTES, Keyring, SigningKey
from robotctl.recording.write.mcap_writer import Sealer
from robotctl.testing.drives import GID, START_NS, TWIST
from tests.support.edited_recordings import Stored as Stored
from tests.support.edited_recordings import stored
from tests.support.waiting import until


def numbered(number: int, size: int = 52) -> bytes:
    """Return message data that is different for each number."""
    return struct.pack("<Q", number) * (size // 8) + bytes(size % 8)


def number_of(data: bytes) -> int:
    """Return the number in data that `numbered` returned."""
    number: int = struct.unpack_from("<Q", data)[0]
    return number


def write_numbered(recorder: Recorder, channel: int, numbers: range, size: int = 52) -> None:
    """Write messages 1 ms apart, numbered and sequenced by `numbers`."""
    for number in numbers:
        stamp = START_NS + number * 1_000_000
        recorder.write(channel, numbered(number, size), stamp, stamp - 500, number, GID)


class Tape(Recorder):
    """A recorder that keeps what it tells; a failure fails the test unless it `may_fail`."""

    def __init__(
        self,
        folder: Path,
        *,
        may_fail: bool = False,
        tells_full: bool = False,
        metadata: Callable[[], Mapping[str, str]] = dict,
        **options: Any,
    ) -> None:
        self.failures: list[str] = []
        self.begun: list[Path] = []
        """The files after the first one."""

        self.full: list[Path] = []
        self._may_fail = may_fail
        super().__init__(
            folder,
            RecorderOptions(**options),
            metadata=metadata,
            on_failure=self.failures.append,
            on_split=self.begun.append,
            on_full=self.full.append if tells_full else None,
        )

    def commands(self, numbers: range, size: int = 52) -> None:
        """Write numbered messages of /cmd_vel."""
        write_numbered(self, self.add_topic(TWIST), numbers, size)

    def close(self) -> RecorderStats:
        stats = super().close()
        assert self._may_fail or self.failures == []
        return stats

    def settle(self) -> None:
        """Wait until all is written."""
        until(lambda: self.stats().queued == 0)


def overwrite(path: Path, at: int, data: bytes) -> None:
    """Put other bytes into a file."""
    with path.open("r+b") as file:
        file.seek(at)
        file.write(data)


def flip(path: Path, at: int, bits: int = 0xFF) -> None:
    """Change bits of one byte of a file."""
    overwrite(path, at, bytes([path.read_bytes()[at] ^ bits]))


def read_strictly(path: Path) -> list[Stored]:
    """Return the messages of a valid file, in file order, read by the mcap package.

    Every checksum is verified, and the summary must agree with the data.

    Raises:
        Exception: The package found a fault in the file.
    """
    channels: dict[int, Channel] = {}
    messages: list[Stored] = []
    with path.open("rb") as stream:
        for record in StreamReader(stream, validate_crcs=True).records:
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                messages.append(stored(channels[record.channel_id], record))
    with path.open("rb") as stream:
        reader = SeekingReader(stream, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError("no summary")
        indexed = [stored(channel, message) for _, channel, message in reader.iter_messages()]
        if sorted(indexed) != sorted(messages):
            raise ValueError("the index leads to other messages than the data section holds")
        if summary.statistics.message_count != len(messages):
            raise ValueError("the statistics count other messages than there are")
    return messages


def record_in_real_time(folder: Path, compression: str, period_s: float, ready: Connection) -> None:
    """Record numbered messages of 52 bytes, stamped with the wall clock, until killed."""
    options = RecorderOptions(compression=Compression(compression))
    recorder = Recorder(folder, options, on_failure=ready.send)
    channel = recorder.add_topic(TWIST)
    ready.send(recorder.stats().file)
    number = 0
    while True:
        number += 1
        now = time.time_ns()
        recorder.write(channel, numbered(number), now, now, number, GID)
        time.sleep(period_s)


def record_up_to_file_size(folder: Path, limit: int, result: Connection) -> None:
    """Record while no file may grow beyond `limit` bytes; send failures and final counts."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    recorder = Tape(
        folder, may_fail=True, compression=Compression.NONE, chunk_bytes=16384, flush_s=0.01
    )
    number = 0
    while not recorder.failures:
        recorder.commands(range(number + 1, number + 101))
        number += 100
        time.sleep(0.001)
    result.send((recorder.failures, number, recorder.close()))


def record_without_memory(folder: Path, result: Connection) -> None:
    """Record large messages with 12 MB of free address space; send failures and counts."""
    recorder = Tape(folder, may_fail=True)
    channel = recorder.add_topic(TWIST)
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    most = resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (now + (12 << 20), most))
    number = 0
    data = random.Random(1).randbytes(4 << 20)
    for number in range(1, 101):
        recorder.write(channel, data, number, number, number, GID)
        recorder.write(channel, data[: number * 1000], number, number, number, GID)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    result.send((recorder.failures, 2 * number, recorder.close()))


CHUNK_BYTES = 1024


def recorded(folder: Path, count: int, **options: Any) -> Path:
    """Write a recording with `count` messages by robotctl's recorder; return its last file."""
    recorder = Tape(folder, **{"chunk_bytes": CHUNK_BYTES, **options})
    recorder.commands(range(1, count + 1))
    stats = recorder.close()
    assert stats.written == count, stats.failure
    return stats.file


def by_mcap(
    path: Path, messages: Iterable[tuple[str, int, bytes]] = (), *, schema: str = "", **options: Any
) -> Path:
    """Write a file by the writer of the mcap package: topic, log time and data of each message."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2", library="somebody")
        schema_id = writer.register_schema(schema, "ros2msg", b"string data\n") if schema else 0
        channels: dict[str, int] = {}
        for number, (topic, log_ns, data) in enumerate(messages, 1):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "cdr", schema_id)
            writer.add_message(channels[topic], log_ns, data, log_ns, number)
        writer.finish()
    return path


def foreign(path: Path, count: int, **options: Any) -> Path:
    """Write a file of another program with `count` numbered messages."""
    numbers = range(1, count + 1)
    messages = [("/cmd_vel", START_NS + n * 1_000_000, numbered(n)) for n in numbers]
    options = {"chunk_size": CHUNK_BYTES, **options}
    return by_mcap(path, messages, schema="std_msgs/msg/String", **options)


def summary_of(path: Path) -> Summary:
    """Return the summary of a file as the mcap package reads it."""
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    return summary


def metadata_of(path: Path) -> list[tuple[str, dict[str, str]]]:
    """Return name and values of the metadata records of a file, in their order."""
    with path.open("rb") as stream:
        return [(each.name, each.metadata) for each in make_reader(stream).iter_metadata()]


def bag_of(folder: Path) -> Any:
    """Return what the `metadata.yaml` of a folder tells."""
    return yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def salvaged(path: Path) -> tuple[list[RecordedMessage], list[str]]:
    """Return all messages that can be read, and what is reported missing."""
    missing: list[str] = []
    return list(read_messages(path, on_missing=missing.append)), missing


def first_numbers(count: int) -> list[bytes]:
    """Return the data of the first `count` numbered messages."""
    return [numbered(number) for number in range(1, count + 1)]


class Forger:
    """Seals a file under the opening of another one, without its private key."""

    def __init__(self, opening: Opening) -> None:
        self._opening = opening
        self._key = SigningKey(bytes(SEED_BYTES))

    def open_file(self, file: str) -> SealOfFile:
        """Return a seal with the opening of the original, and another signing key."""
        return SealOfFile(self._opening, self._key.sign)

    def keep(self, opening: Opening, link: Link, *, closed: bool) -> None:
        """Do nothing: a forger cannot write the robot's journal of decisions."""


def keyring(folder: Path, robot: str = "robot") -> Keyring:
    """Return the keys of a robot in `folder`, which is created."""
    folder.mkdir(mode=0o700, exist_ok=True)
    return Keyring(folder, robot)


def record_sealed(
    folder: Path, sealer: Sealer, *, splits: int = 0, compression: Compression = Compression.ZSTD
) -> list[Path]:
    """Record messages in `splits` + 1 sealed files; return the files."""
    named = {"robot": "robot"}
    recorder = Tape(
        folder, sealer=sealer, compression=compression, chunk_bytes=1 << 12, metadata=named.copy
    )
    for part in range(splits + 1):
        recorder.commands(range(1000 * part + 1, 1000 * part + 200))
        if part < splits:
            recorder.split()
    recorder.close()
    return sorted(folder.glob("*.mcap"))


@contextmanager
def fork_server(*preloaded: str) -> Iterator[ForkServerContext]:
    """Yield a multiprocessing context with `preloaded` modules; end its fork server at the end."""
    context = get_context("forkserver")
    context.set_forkserver_preload(list(preloaded))
    server: Any = forkserver._forkserver
    try:
        yield context
    finally:
        server._stop()
        context.set_forkserver_preload([])
