"""Checks many recordings, in as many processes as there are processors."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from threading import Lock
from typing import Any

from robotctl.processes import Child, program, start
from robotctl.rerun.check import Progress, check_recording
from robotctl.rerun.check_report import Report

WORKER = program("robotctl.rerun.check_process")

POLL_S = 0.1

_WHOLE = 1000
"""In how many parts progress within a recording is told."""


def check_recordings(
    paths: Sequence[Path], on_progress: Progress = lambda done, total: None
) -> list[dict[str, Any]]:
    """The reports, as in `Report.as_object`, in the order of `paths`."""
    if len(paths) == 1:
        return [check_recording(paths[0], on_progress).as_object()]
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
    try:
        with ThreadPoolExecutor(count) as pool:
            try:
                working = [pool.submit(work, worker) for worker in workers]
                while wait(working, POLL_S).not_done:
                    on_progress(round(_WHOLE * sum(shares)), _WHOLE * len(paths))
            finally:
                waiting.clear()
                for worker in workers:
                    worker.end()
    finally:
        for worker in workers:
            worker.close()
    for each in working:
        each.result()
    return reports


class _Worker:
    """A process that checks recording after recording; another one takes over when it has died."""

    def __init__(self) -> None:
        self._child: Child | None = None
        self._ended = False
        self._lock = Lock()

    def check(self, path: Path) -> Iterator[dict[str, Any]]:
        """What the process says of a recording, at last its report."""
        child = self._living()
        if child is None:
            return
        try:
            child.send(f"{json.dumps(str(path))}\n".encode())
            while True:
                for said in child.receive():
                    yield said
                    if "report" in said:
                        return
        except (BrokenPipeError, EOFError, ValueError):
            pass
        report = Report(path)
        report.miss(f"the process that checked it ended with {self.close()}")
        yield {"report": report.as_object()}

    def end(self) -> None:
        """End the process, and start none any more; from any thread."""
        with self._lock:
            self._ended = True
            if self._child is not None:
                self._child.kill()

    def close(self) -> int:
        """Reap the process, by force, when no thread hears it; returns its exit code."""
        with self._lock:
            child, self._child = self._child, None
            return 0 if child is None else child.close()

    def _living(self) -> Child | None:
        """The process, None once it is to end."""
        with self._lock:
            if self._child is None and not self._ended:
                self._child = start(WORKER, with_stdin=True)
            return self._child
