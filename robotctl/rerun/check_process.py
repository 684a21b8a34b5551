"""`python -m robotctl.rerun.check_process --report-fd N`: checks the recordings named on stdin.

A line of JSON each: a path comes on stdin, then {"progress"} and at its end {"report"} leave on N.
The end of stdin ends it: it never outlives the process that asked.
"""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from pathlib import Path

from robotctl.processes import report_fd, send_report
from robotctl.rerun.check import check_recording

PROGRESS_PERIOD_S = 0.1


def main() -> None:
    """Check until stdin ends."""
    descriptor = report_fd(sys.argv)
    for line in sys.stdin:
        told = time.monotonic()

        def tell_progress(done: int, total: int) -> None:
            nonlocal told
            if time.monotonic() - told > PROGRESS_PERIOD_S:
                told = time.monotonic()
                send_report(descriptor, {"progress": done / total})

        send_report(
            descriptor,
            {"report": check_recording(Path(json.loads(line)), tell_progress).as_object()},
        )


if __name__ == "__main__":
    with suppress(BrokenPipeError):  # the process that asked has ended
        main()
