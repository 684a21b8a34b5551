"""Run a daemon from its command line, and report the start on `--ready-fd`."""

from __future__ import annotations

import resource
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

from robotctl.base import environment, own_process
from robotctl.base.errors import INTERRUPTED_EXIT_CODE, Refused, RobotctlError
from robotctl.base.own_process import open_standard_streams
from robotctl.base.paths import lock_path
from robotctl.daemon import command_line as command_line
from robotctl.daemon.command_line import DaemonOptions
from robotctl.daemon.lock import owned
from robotctl.daemon.log.lines import log_to_stderr
from robotctl.daemon.start_report import StartReport


def main(arguments: list[str]) -> int:
    """Run a daemon to its end and return its exit code."""
    open_standard_streams()
    note = environment.prepare()
    with ExitStack() as at_end, log_to_stderr():
        return _main(arguments, [note] if note else [], at_end)


def _main(arguments: list[str], notes: list[str], at_end: ExitStack) -> int:
    """Run as `main` does; `at_end` holds what must happen after everything else, the log too."""
    report = StartReport(command_line.parse_ready_fd(arguments))
    try:
        allow_many_files()
        options = command_line.parse(arguments)
        at_end.enter_context(owned(lock_path(options.robot), options.robot))
        _run(options, report.send, notes, at_end)
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


def _run(
    options: DaemonOptions,
    send: Callable[[Mapping[str, Any]], None],
    notes: list[str],
    at_end: ExitStack,
) -> None:
    from robotctl.daemon.app import serve  # after environment.prepare(): it imports rclpy
    from robotctl.ros.executor import run

    run(serve(options, notes, send, at_end))


def allow_many_files() -> None:
    """Raise the limit: each recorded topic takes a file, and 1,024 is only for select(2).

    Raises:
        Refused: The limit cannot be raised far enough.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most != resource.RLIM_INFINITY and most < own_process.LEAST_OPEN_FILES:
        least = own_process.LEAST_OPEN_FILES
        text = f"this process may open {most} files, and a daemon needs {least}"
        raise Refused(text, own_process.MORE_OPEN_FILES)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
