"""The report of a start to the process that started the daemon: ready, or why not."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
from collections.abc import Mapping
from contextlib import suppress
from threading import Thread
from typing import Any

from robotctl.base.errors import RobotctlError

_log = logging.getLogger("robotctl")

_STDOUT = 1


class StartReport:
    """One report to the starter, on `ready_fd`, or on stdout and stderr if that is None."""

    def __init__(self, ready_fd: int | None) -> None:
        self._ready_fd = ready_fd
        self._in_background = ready_fd is not None
        if ready_fd is not None:
            os.set_inheritable(ready_fd, False)

    def send(self, report: Mapping[str, Any]) -> None:
        """Send the report. A daemon in the background sends only its first report.

        If it reports that it is ready, but the process that started it is gone, it ends itself with
        SIGTERM.
        """
        line = f"{json.dumps(report)}\n".encode()
        if not self._in_background:  # stdout may block: the loop must not wait
            Thread(target=_write, args=(_STDOUT, line), name="READY", daemon=True).start()
        elif self._ready_fd is not None:
            is_read = _write(self._ready_fd, line)
            os.close(self._ready_fd)
            self._ready_fd = None  # the number will be reused
            if report["ready"] and not is_read:
                signal.raise_signal(signal.SIGTERM)  # no user knows of this daemon

    def fail(self, error: RobotctlError) -> int:
        """Report why the daemon ends; return its exit code."""
        if not self._in_background:
            with suppress(OSError):  # stderr is closed
                print(f"robotctl: {error}", file=sys.stderr)
        else:
            _log.error("%s", error)
            failure = {"error": str(error), "exit_code": error.exit_code, **error.details()}
            self.send({"ready": False, **failure})
        return error.exit_code

    def fail_unexpectedly(self, error: Exception) -> int:
        """Report a bug as `fail` does; its traceback goes into the log only."""
        if self._in_background:
            _log.error("the daemon failed", exc_info=error)
        return self.fail(RobotctlError(f"unexpected {type(error).__name__}: {error}"))


def _write(descriptor: int, line: bytes) -> bool:
    """Write the line; return whether its reader still exists."""
    try:
        os.write(descriptor, line)
    except OSError as error:
        _log.warning("the report of the start could not be written: %s", error)
        return False
    return True
