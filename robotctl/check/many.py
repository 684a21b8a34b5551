"""Checks recordings; several of them in parallel, in up to one process per processor.

`python -m robotctl.check.many --report-fd N` is such a process. For each line {"path", "all_bytes"}
on stdin, it writes {"progress"} lines and one {"report"} line, as JSON, to descriptor N. It ends
when stdin is closed, so it does not outlive its parent.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from threading import Lock
from typing import Any

from robotctl.base.processes import Child, program, report_fd, send_report, start
from robotctl.base.store import path_of
from robotctl.check.report import Report
from robotctl.check.run import Progress, check_recording

WORKER = program("robotctl.check.many")

POLL_S = 0.1

_WHOLE = 1000
"""The progress of one recording counts from 0 to this number."""


def check_recordings(
    paths: Sequence[Path],
    on_progress: Progress = lambda done, total: None,
    *,
    all_bytes: bool = False,
) -> list[dict[str, Any]]:
    """Check each path as `check_recording` does; return the JSON reports in the same order."""
    if len(paths) == 1:
        return [check_recording(paths[0], on_progress, all_bytes=all_bytes).as_object()]
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
            for said in worker.check(paths[position], all_bytes=all_bytes):
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
    """A process that checks one recording at a time; it is replaced when it dies."""

    def __init__(self) -> None:
        self._child: Child | None = None
        self._ended = False
        self._lock = Lock()

    def check(self, path: Path, *, all_bytes: bool) -> Iterator[dict[str, Any]]:
        """Yield the progress of the check of one recording, then its report."""
        child = self._living()
        if child is None:
            return
        try:
            job = {"path": str(path), "all_bytes": all_bytes}
            child.send(f"{json.dumps(job)}\n".encode())
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
        """Kill the process and start no other; may be called from any thread."""
        with self._lock:
            self._ended = True
            if self._child is not None:
                self._child.kill()

    def close(self) -> int:
        """Kill the process, from which no other thread may be reading; return its exit code."""
        with self._lock:
            child, self._child = self._child, None
            return 0 if child is None else child.close()

    def _living(self) -> Child | None:
        """Return the process, started if needed; None after `end`."""
        with self._lock:
            if self._child is None and not self._ended:
                self._child = start(WORKER, with_stdin=True)
            return self._child


PROGRESS_PERIOD_S = 0.1


def main() -> None:
    """Check recordings until stdin is closed.

    Raises:
        BrokenPipeError: The process that reads the reports has ended.
    """
    descriptor = report_fd(sys.argv)
    for line in sys.stdin:
        job = json.loads(line)
        told = time.monotonic()

        def tell_progress(done: int, total: int) -> None:
            nonlocal told
            if time.monotonic() - told > PROGRESS_PERIOD_S:
                told = time.monotonic()
                send_report(descriptor, {"progress": done / total})

        path = path_of(job["path"])
        report = check_recording(path, tell_progress, all_bytes=job["all_bytes"])
        send_report(descriptor, {"report": report.as_object()})


if __name__ == "__main__":
    with suppress(BrokenPipeError):  # the parent process has ended
        main()
