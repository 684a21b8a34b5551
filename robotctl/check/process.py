"""`python -m robotctl.check.process --report-fd N`: checks the recordings named on stdin.

For each line {"path", "all_bytes"} on stdin, it writes {"progress"} lines and one {"report"} line,
as JSON, to descriptor N. It ends when stdin is closed, so it does not outlive its parent.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress

from robotctl.base.processes import report_fd, send_report
from robotctl.base.store.remote_file import path_of
from robotctl.check.run import check_recording

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
