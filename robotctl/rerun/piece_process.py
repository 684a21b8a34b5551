"""`python -m robotctl.rerun.piece_process --report-fd N`: re-runs pieces of one recording.

Each line is JSON. On stdin: first {"path", "topic", "version"}, then {"job", "begin", "end"} with
places of the recording; on descriptor N {"job", "confirmed"} for each. For {"job": BYTES} it reads
every byte, and reports {"job", "bytes"}. The process ends when stdin is closed, so it does not
outlive its parent.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.processes import report_fd, send_report
from robotctl.recording import Recording
from robotctl.recording.read.topic_places import Spot
from robotctl.rerun.bytes_check import read_bytes
from robotctl.rerun.piece import BYTES, confirmed_pieces


def main() -> None:
    """Re-run pieces until stdin is closed."""
    descriptor = report_fd(sys.argv)
    task = json.loads(sys.stdin.readline())
    with Recording(Path(task["path"])) as recording:
        do_jobs(recording, task["topic"], task["version"], sys.stdin, descriptor)


def do_jobs(
    recording: Recording, topic: str, version: str, lines: Iterable[str], descriptor: int
) -> None:
    """Do the jobs in `lines`, and report each on the descriptor.

    Raises:
        BrokenPipeError: The process that asked for them has ended.
    """
    for line in lines:
        job = json.loads(line)
        if job["job"] == BYTES:
            found = read_bytes(recording.path)
            send_report(descriptor, {"job": BYTES, "bytes": found and asdict(found)})
            continue
        begin, end = Spot(*job["begin"]), job["end"]
        confirmed = confirmed_pieces(recording, topic, version, begin, end and Spot(*end))
        told = [[position, sorted(piece.unused)] for position, piece in confirmed.items()]
        send_report(descriptor, {"job": job["job"], "confirmed": told})


if __name__ == "__main__":
    with suppress(BrokenPipeError, UnreadableFile):  # the parent has ended, or tells it itself
        main()
