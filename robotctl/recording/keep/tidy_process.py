"""`python -m robotctl.recording.keep.tidy_process JOB --report-fd N`.

Removes old recordings of a folder and repairs unfinished ones, at the lowest CPU priority.

JOB is the JSON object of a TidyJob. On N, a line of JSON for each action: {"text", "problem",
"removed"}; "problem" is true where something could not be done, "removed" is the path of a file
that was removed, or "".
"""

from __future__ import annotations

import os
import sys

os.nice(19)  # before the imports, which could delay the control of a robot

from robotctl.processes import report_fd, send_report  # noqa: E402
from robotctl.recording.keep.tidy_job import TidyJob, tidy  # noqa: E402


def main(arguments: list[str]) -> int:
    """Tidy the folder and return the exit code."""
    descriptor = report_fd(arguments)
    daemon = os.getppid()
    for done in tidy(TidyJob.from_json(arguments[0])):
        if os.getppid() != daemon:  # the daemon has ended; the next one continues
            return 1
        send_report(descriptor, done._asdict())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
