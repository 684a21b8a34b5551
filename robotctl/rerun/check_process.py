"""`python -m robotctl.rerun.check_process --report-fd N`: checks the recordings named on stdin.

Each line is JSON: {"path", "all_bytes"} on stdin; then {"progress"} lines and one {"report"} line
on descriptor N. The process ends when stdin is closed, so it does not outlive its parent.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable
from contextlib import suppress

from robotctl.processes import report_fd, send_report
from robotctl.rerun.check import check_recording
from robotctl.store.store_path import path_of

PROGRESS_PERIOD_S = 0.1


def main() -> None:
    """Check recordings until stdin is closed."""
    check_lines(sys.stdin, report_fd(sys.argv))


def check_lines(lines: Iterable[str], descriptor: int) -> None:
    """Check the recordings that `lines` name, and report on the descriptor.

    Raises:
        BrokenPipeError: The process that asked for them has ended.
    """
    for line in lines:
        job = json.loads(line)
        told = time.monotonic()

        def tell_progress(done: int, total: int) -> None:
            nonlocal told
            if time.monotonic() - told > PROGRESS_PERIOD_S:
                told = time.monotonic()
                send_report(descriptor, {"progress": done / total})

        send_report(
            descriptor,
            {
                "report": check_recording(
                    path_of(job["path"]), tell_progress, all_bytes=job["all_bytes"]
                ).as_object()
            },
        )


if __name__ == "__main__":
    with suppress(BrokenPipeError):  # the parent process has ended
        main()
