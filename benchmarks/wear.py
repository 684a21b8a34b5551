"""How much a recording wears out an SD card: bytes that reach the disk per byte recorded.

    python benchmarks/wear.py --folder ~/somewhere      on the disk in question, not in memory

Writes a whole file of ten minutes as fast as it goes: a commit for each 250 ms of it, and a sync
for each second, as a recorder does. Counted is `write_bytes` of /proc/self/io: what the kernel must
write of the files' pages. A byte recorded is one of a message or its head, before compression. The
drive is one of the simulated robot at 50 Hz; other messages hold 52 random bytes.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from recording.heard_drive import record_drive

from robotctl.recording import RecorderOptions, Topic, read_messages
from robotctl.recording.format.records import MESSAGE_HEAD, PlainMessage
from robotctl.recording.write.buffer import pack
from robotctl.recording.write.channel_state import ChannelState
from robotctl.recording.write.recording_file import RecordingFile

FILE_S = 600.0
COMMIT_S = 0.25
COMMIT_NS = round(COMMIT_S * 1e9)
COMMITS_PER_SYNC = 4
DRIVE_S = 20.0
MESSAGE_BYTES = 52
TARGETS = {"a drive at 50 Hz": 4.0, "30 topics at 3 Hz": 8.0, "300 topics at 10 Hz": 4.0}


def written_bytes() -> int:
    """Bytes that this process has caused to be written to a disk."""
    lines = Path("/proc/self/io").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("write_bytes"))


def drive(scratch: Path) -> tuple[list[Topic], Iterator[list[PlainMessage]]]:
    """The topics of a drive, and what each commit holds, over and over."""
    path = record_drive(scratch / "drive", DRIVE_S, rate_hz=50.0, moving=True)
    topics: dict[str, int] = {}
    commits: dict[int, list[PlainMessage]] = {}
    for message in read_messages(path):
        channel = topics.setdefault(message.topic, len(topics))
        commits.setdefault(message.log_ns // COMMIT_NS, []).append(
            (channel, bytes(message.data), message.log_ns, message.publish_ns, 1)
        )
    named = [Topic(name, "a/msg/B", "x\n") for name in topics]
    whole = list(commits.values())[1:-1]

    def repeated() -> Iterator[list[PlainMessage]]:
        while True:
            yield from whole

    return named, repeated()


def regular(topics: int, rate_hz: float) -> tuple[list[Topic], Iterator[list[PlainMessage]]]:
    """Topics of one rate, and what each commit holds."""
    dice = random.Random(1)

    def commits() -> Iterator[list[PlainMessage]]:
        due, number = [dice.random() / rate_hz for _ in range(topics)], 0
        while True:
            number += 1
            taken: list[PlainMessage] = []
            for channel in range(topics):
                while due[channel] < number * COMMIT_S:
                    at_ns = round(due[channel] * 1e9)
                    taken.append((channel, dice.randbytes(MESSAGE_BYTES), at_ns, at_ns, number))
                    due[channel] += 1 / rate_hz
            yield taken

    return [Topic(f"/topic{number}", "a/msg/B", "x\n") for number in range(topics)], commits()


def measure(
    folder: Path, topics: list[Topic], commits: Iterator[list[PlainMessage]]
) -> tuple[float, float]:
    """Write a file; return the bytes written and those of the file, per byte recorded."""
    folder.mkdir()
    channels = [ChannelState(topic) for topic in topics]
    recorded, before = 0, written_bytes()
    file = RecordingFile(folder / "file.mcap", RecorderOptions(), {}, channels)
    for number in range(round(FILE_S / COMMIT_S)):
        messages = next(commits)
        recorded += sum(MESSAGE_HEAD.size + len(message[1]) for message in messages)
        file.write(pack(messages))
        if number % COMMITS_PER_SYNC == 0:
            file.sync()
    file.finish()
    return (written_bytes() - before) / recorded, file.size / recorded


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--folder", type=Path, help="on the disk that is measured")
    options = parser.parse_args()
    reached = True
    with tempfile.TemporaryDirectory(dir=options.folder) as temporary:
        scratch = Path(temporary)
        subjects = {
            "a drive at 50 Hz": drive(scratch),
            "30 topics at 3 Hz": regular(30, 3.0),
            "300 topics at 10 Hz": regular(300, 10.0),
        }
        for number, (name, subject) in enumerate(subjects.items()):
            written, size = measure(scratch / str(number), *subject)
            reached = reached and written <= TARGETS[name]
            print(f"{name:20} {written:6.2f}, to be at most {TARGETS[name]:g}   file {size:.2f}")
    return 0 if reached else 1


if __name__ == "__main__":
    sys.exit(main())
