"""Makes the indexes of recordings that have none, or an old one, in processes of their own."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

from robotctl.errors import RobotctlError
from robotctl.fleet.history import rows_of
from robotctl.fleet.index_file import stamp_of, write_index
from robotctl.recording.read.verified import verify_recording
from robotctl.rerun.check import check_recording

Failures = dict[Path, str]
"""Recordings that could not be indexed, each with the reason."""


def index_recording(recording: Path) -> str:
    """Check and verify a recording and write its index; return why that failed, or "".

    It runs in another process, so that it returns its error as a text.
    """
    try:
        stamp = stamp_of(recording)
        verify = verify_recording(recording).proof.value
        report = check_recording(recording)
        says = [each.text for each in report.violations] + report.missing
        rows = rows_of(recording, report.verdict.value, says[0] if says else None, verify)
        write_index(recording, rows, stamp)
    except (RobotctlError, OSError) as error:
        return str(error)
    return ""


def index_recordings(
    recordings: Sequence[Path],
    executor: Executor,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Failures:
    """Index recordings, and return those that failed."""
    failures: Failures = {}
    jobs = {executor.submit(index_recording, path): path for path in recordings}
    for done, job in enumerate(as_completed(jobs)):
        on_progress(done, len(jobs))
        try:
            said = job.result()
        except BrokenProcessPool:
            said = "the process that indexed it was killed"
        if said:
            failures[jobs[job]] = said
    return failures


@contextmanager
def processes(count: int | None = None) -> Iterator[Executor]:
    """Yield an executor with so many processes, one a processor by default.

    They ignore Ctrl-C, which ends the process that started them, and are killed at the end.
    """
    executor = ProcessPoolExecutor(
        count or len(os.sched_getaffinity(0)),
        mp_context=get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),
    )
    try:
        yield executor
    finally:
        workers = list((executor._processes or {}).values())
        executor.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.kill()
