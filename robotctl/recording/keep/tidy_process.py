"""`python -m robotctl.recording.keep.tidy_process JOB --report-fd N`: tidies at lowest priority.

JOB is the JSON object of a TidyJob. A line of JSON on N for each thing done: {"text", "problem"}.
"""

from __future__ import annotations

import os
import sys

os.nice(19)  # before anything is imported: somebody controls a robot on this machine

from robotctl.processes import report_fd, send_report  # noqa: E402
from robotctl.recording.keep.tidy_job import TidyJob, tidy  # noqa: E402


def main(arguments: list[str]) -> int:
    """Tidy the folder and return the exit code."""
    descriptor = report_fd(arguments)
    daemon = os.getppid()
    for done in tidy(TidyJob.from_json(arguments[0])):
        if os.getppid() != daemon:  # the next daemon goes on
            return 1
        send_report(descriptor, done._asdict())
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
