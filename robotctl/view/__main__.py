"""`python -m robotctl.view --report-fd N`: serve the view that the first line on stdin asks for.

The line is a `ViewJob`. The reports on descriptor N are {"ready"} with `url`, `open` and `port`,
{"note"}, {"ended"} with the reason, and {"error", "exit_code"} with details of the error.
The process ends on a signal, with the daemon, and when stdin is closed (see `outlives_stdin`).
"""

from __future__ import annotations

import asyncio
import sys
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

from robotctl.base import environment
from robotctl.base.errors import RobotctlError
from robotctl.base.processes import report_fd, send_report
from robotctl.view.serving import serve
from robotctl.view.view_job import ViewJob


def main(arguments: list[str]) -> int:
    """Serve one view, and return the exit code."""
    with ExitStack() as at_end:  # what must be closed last
        note = environment.prepare()
        report = partial(_report, report_fd(arguments))
        line = sys.stdin.buffer.readline()
        if not line.endswith(b"\n"):
            return 0
        if note:
            report({"note": note})
        try:
            asyncio.run(serve(ViewJob.from_json(line), report, at_end))
        except RobotctlError as error:
            report({"error": str(error), "exit_code": error.exit_code, **error.details()})
            return error.exit_code
        except Exception as error:  # noqa: BLE001 - the command shows it
            text = f"unexpected {type(error).__name__}: {error}"
            report({"error": text, "exit_code": RobotctlError.exit_code})
            return RobotctlError.exit_code
    return 0


def _report(descriptor: int, said: dict[str, Any]) -> None:
    with suppress(BrokenPipeError):  # the command has ended, or does not read reports any more
        send_report(descriptor, said)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
