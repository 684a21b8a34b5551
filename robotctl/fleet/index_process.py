"""`python -m robotctl.fleet.index_process RECORDING --report-fd N`: index it at low priority.

One line of JSON on N: {"failure"}, "" if the index was written. If the process that started it has
ended, a failure goes to stderr.
"""

from __future__ import annotations

import os
import sys

os.nice(19)  # before the imports, which could delay the control of a robot

from pathlib import Path  # noqa: E402

from robotctl.fleet.recording_index import index_recording  # noqa: E402
from robotctl.processes import report_fd, send_report  # noqa: E402


def main(arguments: list[str]) -> int:
    """Index the recording and return the exit code."""
    descriptor = report_fd(arguments)
    recording = Path(arguments[0])
    failure = index_recording(recording)
    try:
        send_report(descriptor, {"failure": failure})
    except BrokenPipeError:
        if failure:
            print(f"{recording} was not indexed: {failure}", file=sys.stderr)
    return 1 if failure else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
