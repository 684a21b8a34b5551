"""`python -m robotctl.recording.keep.clip_process JOB --report-fd N`: cut a clip at low priority.

JOB is the JSON object of a ClipJob. One line of JSON on N: {"target", "lost"} or {"error"}.
"""

from __future__ import annotations

import os
import sys

os.nice(19)  # before the imports, which could delay the control of a robot

from robotctl.errors import RobotctlError  # noqa: E402
from robotctl.processes import report_fd, send_report  # noqa: E402
from robotctl.recording.keep.clip_job import ClipJob, make_clip  # noqa: E402


def main(arguments: list[str]) -> int:
    """Cut the clip and return the exit code."""
    descriptor = report_fd(arguments)
    try:
        made = make_clip(ClipJob.from_json(arguments[0]))
    except RobotctlError as error:
        send_report(descriptor, {"error": str(error)})
        return error.exit_code
    send_report(descriptor, {"target": str(made.target), "lost": list(made.lost)})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
