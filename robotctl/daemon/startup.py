"""Run a daemon from its command line, and report the start on `--ready-fd`."""

from __future__ import annotations

import json
import logging
import os
import resource
import signal
import sys
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from threading import Thread
from typing import Any

from robotctl.base import environment, own_process
from robotctl.base.errors import INTERRUPTED_EXIT_CODE, Refused, RobotctlError
from robotctl.base.own_process import open_standard_streams
from robotctl.base.paths import lock_path
from robotctl.daemon import command_line as command_line
from robotctl.daemon.lock import owned
from robotctl.daemon.log_lines import log_to_stderr

_log = logging.getLogger("robotctl")

_STDOUT = 1


class StartReport:
    """Reports to the process that starts the daemon: on `ready_fd`, or on stdout and stderr."""

    def __init__(self, ready_fd: int | None) -> None:
        self._ready_fd = ready_fd
        self._in_background = ready_fd is not None
        if ready_fd is not None:
            os.set_inheritable(ready_fd, False)

    def send(self, report: Mapping[str, Any]) -> None:
        """Send a report; on `ready_fd`, only the first one is sent.

        If the report of a ready daemon cannot be written there, SIGTERM ends the daemon.
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
        """Report the error that ends the daemon, and return the exit code."""
        if not self._in_background:
            with suppress(OSError):  # stderr is closed
                print(f"robotctl: {error}", file=sys.stderr)
        else:
            _log.error("%s", error)
            failure = {"error": str(error), "exit_code": error.exit_code, **error.details()}
            self.send({"ready": False, **failure})
        return error.exit_code

    def fail_unexpectedly(self, error: Exception) -> int:
        """Report a bug, and return the exit code."""
        if self._in_background:
            _log.error("the daemon failed", exc_info=error)
        return self.fail(RobotctlError(f"unexpected {type(error).__name__}: {error}"))


def _write(descriptor: int, line: bytes) -> bool:
    """Write the line; return whether that succeeded."""
    try:
        os.write(descriptor, line)
    except OSError as error:
        _log.warning("the report of the start could not be written: %s", error)
        return False
    return True


def main(arguments: list[str]) -> int:
    """Run a daemon to its end and return its exit code."""
    open_standard_streams()
    note = environment.prepare()
    with ExitStack() as at_end, log_to_stderr():
        return _main(arguments, [note] if note else [], at_end)


def _main(arguments: list[str], notes: list[str], at_end: ExitStack) -> int:
    """Run a daemon and return its exit code. The caller closes `at_end` after the log."""
    report = StartReport(command_line.parse_ready_fd(arguments))
    try:
        allow_many_files()
        options = command_line.parse(arguments)
        at_end.enter_context(owned(lock_path(options.robot), options.robot))
        from robotctl.daemon.app import serve  # after environment.prepare(): it imports rclpy
        from robotctl.ros.executor import run

        run(serve(options, notes, report.send, at_end))
    except RobotctlError as error:
        return report.fail(error)
    except KeyboardInterrupt:  # before the loop handles signals
        return INTERRUPTED_EXIT_CODE
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        return report.fail(RobotctlError(f"{error.strerror or error}{where}"))
    except Exception as error:  # noqa: BLE001 - the report gets any error
        return report.fail_unexpectedly(error)
    return 0


def allow_many_files() -> None:
    """Raise the limit of open files to the hard limit.

    Raises:
        Refused: The hard limit is too low.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most != resource.RLIM_INFINITY and most < own_process.LEAST_OPEN_FILES:
        least = own_process.LEAST_OPEN_FILES
        text = f"this process may open {most} files, and a daemon needs {least}"
        raise Refused(text, own_process.MORE_OPEN_FILES)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
