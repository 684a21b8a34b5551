"""Runs one function over many recordings, in any executor of `concurrent.futures`."""

from __future__ import annotations

import errno
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import get_context, parent_process
from pathlib import Path
from threading import Thread
from typing import Final, TypeVar

from robotctl.base.errors import IN_PARENTHESES, RobotctlError

Result = TypeVar("Result")

Processes = Callable[[int], AbstractContextManager[Executor]]
"""Starts an executor; the argument is the number of jobs."""

Done = Callable[[int, int], None]
"""A callback for progress, with the number of finished jobs and of all jobs."""


THREADS: Final = 16


def results_of(
    function: Callable[[Path], Result],
    recordings: Sequence[Path],
    processes: Processes,
    on_progress: Done = lambda done, total: None,
) -> Iterator[tuple[Path, Result | None]]:
    """Call `function` for each recording; yield recording and result in the order of completion.

    If a process dies, the unfinished jobs run again, one by one; a job that dies again yields None.
    """
    done = 0
    lost: list[Path] = []
    for batch in (recordings, lost):
        groups = [list(batch)] if batch is recordings else [[each] for each in lost]
        for group in groups:
            for path, result, is_lost in _run(function, group, processes):
                if is_lost and batch is recordings:
                    lost.append(path)
                    continue
                done += 1
                on_progress(done, len(recordings))
                yield path, result


def _run(
    function: Callable[[Path], Result], recordings: Sequence[Path], processes: Processes
) -> Iterator[tuple[Path, Result | None, bool]]:
    if not recordings:
        return
    with processes(len(recordings)) as executor:
        jobs = {executor.submit(function, path): path for path in recordings}
        for job in as_completed(jobs):
            try:
                yield jobs[job], job.result(), False
            except BrokenExecutor:
                yield jobs[job], None, True


@contextmanager
def local_threads(jobs: int) -> Iterator[Executor]:
    """Yield an executor for I/O-bound jobs, with a thread per job, at most `THREADS` of them."""
    executor = ThreadPoolExecutor(min(jobs, THREADS))
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)


def _begin_process() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGKILL)


@contextmanager
def local_processes(jobs: int) -> Iterator[Executor]:
    """Yield an executor with a process per CPU, but at most one per job.

    The processes ignore Ctrl-C. They are killed at the end of the block, and with their parent.

    Raises:
        RobotctlError: The system has no shared memory for them.
    """
    try:
        executor = ProcessPoolExecutor(
            min(jobs, len(os.sched_getaffinity(0))),
            mp_context=get_context("spawn"),
            initializer=_begin_process,
        )
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):
            raise
        cause = f"/dev/shm, which several processes need, fails: {error.strerror}"
        cure = "make it writable, or give one recording at a time"
        raise RobotctlError(cause, cure, sentence=IN_PARENTHESES) from None
    try:
        yield executor
    finally:
        workers = list((executor._processes or {}).values())
        executor.shutdown(wait=False, cancel_futures=True)
        for worker in workers:
            worker.kill()
