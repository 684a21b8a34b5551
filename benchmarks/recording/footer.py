"""The cost of rewriting the footer every 250 ms, in a file of the default length.

Thirty topics with three messages a second each: with so many slow topics, the summary in the footer
is as large, relative to the data, as it gets on a robot.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from recording.figures import Figure

from robotctl.recording import RecorderOptions, Topic
from robotctl.recording.format.disk import Buffer, DiskFile
from robotctl.recording.format.records import MESSAGE_HEAD
from robotctl.recording.write.bag_writer import RecordingFile
from robotctl.recording.write.buffer import pack
from robotctl.recording.write.channel_state import ChannelState

TOPICS = 30
MESSAGE_BYTES = 52

CPU = "footer of a quiet robot [% of one core]"
RATIO = "footer of a quiet robot, bytes written per byte recorded"
RATE = "footer of a quiet robot [MB/s written]"


def figures() -> Iterator[Figure]:
    yield Figure(CPU, 2.0)
    yield Figure(RATIO, digits=".1f")
    yield Figure(RATE)


def measure(scratch: Path) -> Iterator[tuple[str, float]]:
    """Write a whole file as fast as possible, with the recorder's commits and syncs."""
    written = 0

    class CountedFile(DiskFile):
        def write_at(self, parts: Sequence[Buffer], offset: int) -> None:
            nonlocal written
            written += sum(map(len, parts))
            super().write_at(parts, offset)

    options = RecorderOptions(open_file=CountedFile)
    commits = int(options.split_s / options.flush_s)
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        channels = [ChannelState(Topic(f"/topic{n}", "a/msg/B", "x\n")) for n in range(TOPICS)]
        file = RecordingFile(Path(folder) / "file.mcap", options, {}, channels)
        taken = pack([(channel, bytes(MESSAGE_BYTES), 1, 1, 1) for channel in range(TOPICS)])
        begun = time.process_time()
        for number in range(commits):
            file.write(taken)
            if number % round(options.sync_s / options.flush_s) == 0:
                file.sync()
        spent = time.process_time() - begun
        file.finish()
    yield CPU, 100 * spent / options.split_s
    yield RATIO, written / (commits * TOPICS * (MESSAGE_HEAD.size + MESSAGE_BYTES))
    yield RATE, written / options.split_s / 1e6
