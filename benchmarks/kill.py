"""How many recordings of a killed recorder each of four readers cannot read.

    python benchmarks/kill.py                     200 kills, about 10 minutes
    python benchmarks/kill.py -n 40 --bytes 724 --hz 1000

A process records images of 1 MB, 60 a second, with the default options, and gets SIGKILL after 0.5
to 1.5 s. Each file is then opened by our reader, by the `mcap` package through the summary and as a
stream, and by `rosbags`; all of them read every message and check every CRC that they know of. A
file counts as unreadable for a reader that raises an error, names something as missing, or finds
half a second less than another reader. Only a reader that scans from the start may find one more
chunk than the others: the kill fell between that chunk and the summary that names it. This is no
power cut: the process is killed, and the page cache of the machine survives.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory

from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from robotctl.recording import Recorder, Topic, read_messages
from robotctl.ros.executor import UNKNOWN_GID

TARGET = 1 / 200
IMAGES = Topic("/image", "sensor_msgs/msg/Image")
START_S = 30.0
LOST_S = 0.5


def record(folder: Path, size: int, hz: float, ready: Connection) -> None:
    """Record images that do not compress, until killed."""
    images = [random.randbytes(size) for _ in range(4)]
    recorder = Recorder(folder, on_failure=sys.exit)
    channel = recorder.add_topic(IMAGES)
    ready.send(recorder.stats().file)
    number, begun = 0, time.monotonic()
    while True:
        number += 1
        now_ns = time.time_ns()
        recorder.write(channel, images[number % 4], now_ns, now_ns, number, UNKNOWN_GID)
        time.sleep(max(0.0, begun + number / hz - time.monotonic()))


def by_ours(path: Path) -> int:
    missing: list[str] = []
    count = sum(1 for _ in read_messages(path, on_missing=missing.append))
    if missing:
        raise ValueError(missing[0])
    return count


def by_summary(path: Path) -> int:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError("no summary")
        count = sum(1 for _ in reader.iter_messages())
        if count != summary.statistics.message_count:
            raise ValueError("the statistics count other messages")
    return count


def as_stream(path: Path) -> int:
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        return sum(isinstance(record, Message) for record in records)


def by_rosbags(path: Path) -> int:
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as bag:
        return sum(1 for _ in bag.messages())


READERS: dict[str, Callable[[Path], int]] = {
    "robotctl": by_ours,
    "mcap, summary": by_summary,
    "mcap, stream": as_stream,
    "rosbags": by_rosbags,
}


def killed(folder: Path, arguments: argparse.Namespace) -> Path:
    """Record in a child process and kill it; return the file that it leaves."""
    context = get_context("forkserver")
    ours, theirs = context.Pipe()
    child = context.Process(
        target=record, args=(folder, arguments.bytes, arguments.hz, theirs), daemon=True
    )
    child.start()
    if not ours.poll(START_S):
        raise SystemExit("the recorder did not start")
    file: Path = ours.recv()
    time.sleep(random.uniform(0.5, 1.5))
    assert child.pid is not None
    os.kill(child.pid, signal.SIGKILL)
    child.join()
    return file


def unreadable_by(path: Path, hz: float) -> dict[str, str]:
    """Return the error of each reader that cannot read the file, by reader."""
    counts, errors = {}, {}
    for name, read in READERS.items():
        try:
            counts[name] = read(path)
        except Exception as error:  # noqa: BLE001 - any of other packages
            errors[name] = f"{type(error).__name__}: {error}"[:200]
    most = max(counts.values(), default=0)
    for name, count in counts.items():
        if count < most - LOST_S * hz:
            errors[name] = f"{count} of {most} messages"
    return errors


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-n", type=int, default=200, help="kills")
    parser.add_argument("--bytes", type=int, default=1_000_000, help="of an image")
    parser.add_argument("--hz", type=float, default=60.0)
    parser.add_argument("--scratch", type=Path, help="a folder on the disk to use")
    arguments = parser.parse_args()
    get_context("forkserver").set_forkserver_preload(["robotctl.recording.write.recorder"])
    found = dict.fromkeys(READERS, 0)
    with TemporaryDirectory(dir=arguments.scratch) as scratch:
        for number in range(arguments.n):
            folder = Path(scratch) / str(number)
            errors = unreadable_by(killed(folder, arguments), arguments.hz)
            for name, text in errors.items():
                found[name] += 1
                print(f"kill {number + 1}, {name}: {text}", file=sys.stderr)
            rmtree(folder)
    print("| reader | unreadable | share | target | |\n|---|---|---|---|---|")
    for name, count in found.items():
        share = count / arguments.n
        verdict = "reached" if share <= TARGET else "MISSED"
        print(f"| {name} | {count} of {arguments.n} | {share:.1%} | {TARGET:.1%} | {verdict} |")
    return int(max(found.values()) > TARGET * arguments.n)


if __name__ == "__main__":
    sys.exit(main())
