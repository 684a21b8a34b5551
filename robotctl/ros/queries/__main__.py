"""`python -m robotctl.ros.queries --report-fd N`: do what the first line on stdin asks.

The line is a JSON object with the name of a look (`names`, `topic`, `node`, `listen`, `call`), the
domain, and what the look needs. The
reports are the answers; a failure is {"error", "exit_code"} with details of the error. The process
ends with its stdin, so it does not outlive its parent.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from contextlib import suppress
from functools import partial

from robotctl.base import environment
from robotctl.base.errors import RobotctlError
from robotctl.base.processes import report_fd, send_report


def main(arguments: list[str]) -> int:
    """Do one look and return the exit code."""
    environment.prepare()
    send = partial(send_report, report_fd(arguments))
    with suppress(BrokenPipeError, asyncio.CancelledError):  # nothing waits for the answer any more
        try:
            # After environment.prepare(), because it imports rclpy; before the wait for the line.
            from robotctl.ros.queries.queries import look

            line = _first_line()
            if not line:
                return 0
            request = json.loads(line)
            look(request, send)
        except RobotctlError as error:
            send({"error": str(error), "exit_code": error.exit_code, **error.details()})
        except Exception as error:  # noqa: BLE001 - the command shows it
            text = f"unexpected {type(error).__name__}: {error}"
            send({"error": text, "exit_code": RobotctlError.exit_code})
    return 0


def _first_line() -> bytes:
    line = b""
    while not line.endswith(b"\n") and (piece := os.read(0, 1 << 16)):
        line += piece
    return line


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
