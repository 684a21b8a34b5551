"""Processes that re-run the pieces of a recording ahead of the check that goes through it."""

from __future__ import annotations

import json
import os
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from types import TracebackType
from typing import Final, Self

from robotctl import __version__
from robotctl.errors import UnreadableFile
from robotctl.processes import Child, fork, has_one_thread, program, start
from robotctl.recording import Recording
from robotctl.recording.read.journal_reader import journal_topic
from robotctl.recording.read.topic_places import Spot
from robotctl.rerun.bytes_check import BytesFound, is_small
from robotctl.rerun.piece import BYTES, Position
from robotctl.rerun.piece_process import do_jobs
from robotctl.rerun.rerun import ConfirmedPiece

WORKER: Final = program("robotctl.rerun.piece_process")

JOB_BYTES: Final = 1 << 20
"""A job is about this much of the recording [bytes], decompressed: 80 ms of work."""

LEAST_BYTES: Final = 8 * JOB_BYTES
"""A shorter recording is checked before another process has started."""

BYTES_PATIENCE_S: Final = 2.0
"""How long the check waits at its end for the process that reads every byte; it began with that."""

_AHEAD = 3
"""How many jobs a process is given at once, so that it never waits for the next one."""

_LEAD = 4
"""How many jobs lie between those of a process. The check passes two or three confirmed ones while
a process does one. A job that is unfinished when the check reaches it is wasted."""


class PiecePool:
    """The processes, and what they have confirmed. Use it in a `with` block.

    A process that ends or hangs only costs speed: the check re-runs what it was given.
    """

    def __init__(
        self,
        begin: Callable[[], Child],
        places: Sequence[tuple[Spot, int]],
        processes: int,
        *,
        reads_bytes: bool,
    ) -> None:
        """Divide the `places` of the journal among `processes`, by their size in bytes.

        `begin` starts one, and raises OSError if it cannot. With `reads_bytes` the first one reads
        every byte of the recording before.
        """
        self._begins = cut_places(places, JOB_BYTES)
        self._waiting = list(range(1, len(self._begins)))
        self._reached = 0
        """The job that the check has reached."""

        self._confirmed: dict[int, dict[Position, ConfirmedPiece]] = {}
        self._bytes: BytesFound | None = None
        self._given: dict[Child, list[int]] = {}
        for number in range(min(processes, len(self._waiting))):
            try:
                child = begin()
            except OSError:
                break  # no memory or descriptors: the check does more itself
            self._given[child] = []
            if reads_bytes and not number:
                self._given[child].append(BYTES)
                self._send(child, {"job": BYTES})
            self._give(child)

    def __enter__(self) -> Self:
        """Return the pool."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the processes."""
        for child in list(self._given):
            self._drop(child)

    def confirmed(self, position: Position) -> ConfirmedPiece | None:
        """Return the piece that begins at this position, None if it is not confirmed.

        Then the caller must re-run it, which takes no longer than to wait for a process.
        """
        self._reached = job = bisect_right(self._begins, Spot(position.file, position.offset)) - 1
        del self._waiting[: bisect_right(self._waiting, job)]
        for child in list(self._given):
            self._receive(child, 0.0)
        return self._confirmed.get(job, {}).get(position)

    def bytes_found(self) -> BytesFound | None:
        """Return what reading every byte has found, None if no process did."""
        end_s = time.monotonic() + BYTES_PATIENCE_S
        while (left_s := end_s - time.monotonic()) > 0.0:
            reader = next((each for each, jobs in self._given.items() if BYTES in jobs), None)
            if reader is None:
                break
            self._receive(reader, left_s)
        return self._bytes

    def _receive(self, child: Child, seconds: float) -> None:
        """Read the reports of a process for up to `seconds`; drop it if it ended."""
        try:
            reports = child.receive(seconds)
        except TimeoutError:
            return
        except (EOFError, ValueError):
            self._drop(child)
            return
        for report in reports:
            self._given[child].remove(report["job"])
            if report["job"] == BYTES:
                self._bytes = report["bytes"] and BytesFound(**report["bytes"])
                continue
            found = {
                Position(*position): ConfirmedPiece(frozenset(unused))
                for position, unused in report["confirmed"]
            }
            self._confirmed[report["job"]] = found
        self._give(child)

    def _give(self, child: Child) -> None:
        """Give a process the next jobs that it will have done before the check is there."""
        if BYTES in self._given.get(child, ()):
            return  # it is busy for long
        while child in self._given and len(self._given[child]) < _AHEAD:
            soonest = self._reached + 1 + _LEAD * len(self._given[child])
            place = bisect_left(self._waiting, soonest)
            if place == len(self._waiting):
                return  # the check does what is left itself
            job = self._waiting.pop(place)
            self._given[child].append(job)
            end = self._begins[job + 1] if job + 1 < len(self._begins) else None
            self._send(child, {"job": job, "begin": self._begins[job], "end": end})

    def _send(self, child: Child, line: object) -> None:
        try:
            child.send(f"{json.dumps(line)}\n".encode())
        except BrokenPipeError:
            self._drop(child)

    def _drop(self, child: Child) -> None:
        del self._given[child]
        with suppress(ProcessLookupError):
            child.kill()
        child.close()


@contextmanager
def pool_for(recording: Recording, version: str, processes: int) -> Iterator[PiecePool | None]:
    """Start `processes` for a recording, or none if it is too short for them.

    Only recordings of this version are re-run in pieces: others need more than yes or no.
    """
    topic = journal_topic(recording.info())
    if not processes or topic is None or version != __version__ or recording.is_live:
        yield None
        return
    places = recording.spots(topic)
    if sum(size for _, size in places) < LEAST_BYTES:
        yield None
        return
    begin = partial(begin_helper, recording, topic, version)
    reads_bytes = is_small(recording.path)
    with PiecePool(begin, places, processes, reads_bytes=reads_bytes) as pool:
        yield pool


def begin_helper(recording: Recording, topic: str, version: str) -> Child:
    """Start a process that re-runs pieces: a copy of this one, if that is safe.

    Importing the kernel again would take it 0.15 s, half a minute of the recording.

    Raises:
        OSError: It cannot be started.
    """
    if has_one_thread():
        return fork(partial(_work_as_copy, recording, topic, version))
    child = start(WORKER, with_stdin=True)
    task = {"path": str(recording.path), "topic": topic, "version": version}
    with suppress(BrokenPipeError):  # it has ended already: the pool will notice
        child.send(f"{json.dumps(task)}\n".encode())
    return child


def _work_as_copy(
    recording: Recording, topic: str, version: str, stdin: int, descriptor: int
) -> None:
    with suppress(BrokenPipeError, UnreadableFile), os.fdopen(stdin) as lines:
        do_jobs(recording, topic, version, lines, descriptor)


def cut_places(places: Sequence[tuple[Spot, int]], job_bytes: int) -> list[Spot]:
    """Return where each job begins."""
    begins: list[Spot] = []
    size = job_bytes
    for spot, length in places:
        if size >= job_bytes:
            begins.append(spot)
            size = 0
        size += length
    return begins
