"""Checks many recordings, in as many processes as there are processors."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from threading import Lock
from typing import Any

from robotctl.replay.check import Progress, check
from robotctl.replay.report import Report

WORKER = (sys.executable, "-P", "-m", "robotctl.replay.check_worker")
"""-P: what lies in the working directory is not imported in place of a library."""

POLL_S = 0.1

_WHOLE = 1000
"""In how many parts progress within a recording is told."""


def check_many(
    paths: Sequence[Path], on_progress: Progress = lambda done, total: None
) -> list[dict[str, Any]]:
    """The reports, as in `Report.as_object`, in the order of `paths`."""
    if len(paths) == 1:
        return [check(paths[0], on_progress).as_object()]
    count = min(len(os.sched_getaffinity(0)), len(paths))
    waiting = deque(range(len(paths)))
    shares = [0.0] * len(paths)
    reports: list[dict[str, Any]] = [{} for _ in paths]

    def work(worker: _Worker) -> None:
        while True:
            try:
                position = waiting.popleft()
            except IndexError:
                return
            for said in worker.check(paths[position]):
                shares[position] = said.get("progress", 1.0)
                reports[position] = said.get("report", {})

    workers = [_Worker() for _ in range(count)]
    with ThreadPoolExecutor(count) as pool:
        try:
            working = [pool.submit(work, worker) for worker in workers]
            while wait(working, POLL_S).not_done:
                on_progress(round(_WHOLE * sum(shares)), _WHOLE * len(paths))
        finally:
            waiting.clear()
            for worker in workers:
                worker.end()
    for each in working:
        each.result()
    return reports


class _Worker:
    """A process that checks one recording after the other; a new one where it has died.

    `end` may be called from any thread: no process is begun afterwards.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._ended = False
        self._lock = Lock()

    def check(self, path: Path) -> Iterator[dict[str, Any]]:
        """What the process says of a recording, at last its report."""
        process = self._living()
        if process is None:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            os.write(process.stdin.fileno(), f"{json.dumps(str(path))}\n".encode())
            for line in process.stdout:
                said: dict[str, Any] = json.loads(line)
                yield said
                if "report" in said:
                    return
        except (BrokenPipeError, ValueError):
            pass
        self._kill()
        report = Report(path)
        report.miss(f"the process that checked it ended with {process.returncode}")
        yield {"report": report.as_object()}

    def end(self) -> None:
        """End the process, and begin none any more."""
        with self._lock:
            self._ended = True
        self._kill()

    def _living(self) -> subprocess.Popen[bytes] | None:
        """The process, None once it is to end."""
        with self._lock:
            if self._process is None and not self._ended:
                self._process = subprocess.Popen(
                    WORKER,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    process_group=0,  # a Ctrl-C is for us: it may come while Python starts there
                )
            return self._process

    def _kill(self) -> None:
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()
            with process:  # reaps it, and closes its pipes
                pass
