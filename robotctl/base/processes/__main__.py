"""`python -m robotctl.base.processes WORK JOB --report-fd N`: do a job at the lowest CPU priority.

WORK is `module:function`. The function gets the JSON object JOB and a function that sends a report,
which is one line of JSON on descriptor N. A RobotctlError becomes the report {"error": text}; it is
printed to stderr if the process that started this one has ended.
"""

from __future__ import annotations

import os
import sys

os.nice(19)  # before the imports, which could delay the control of a robot

import json  # noqa: E402
from functools import partial  # noqa: E402
from importlib import import_module  # noqa: E402

from robotctl.base.errors import RobotctlError  # noqa: E402
from robotctl.base.processes.pipes import report_fd, send_report  # noqa: E402


def main(arguments: list[str]) -> int:
    """Do the job and return the exit code."""
    report = partial(send_report, report_fd(arguments))
    work, job = arguments[:2]
    module, _, name = work.partition(":")
    try:
        getattr(import_module(module), name)(json.loads(job), report)
    except BrokenPipeError:  # the process that started this one has ended
        return 1
    except RobotctlError as error:
        try:
            report({"error": str(error)})
        except BrokenPipeError:
            print(f"{work} {job}: {error}", file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
