"""`python -m robotctl.daemon`: starts a daemon and says on `--ready-fd` what came of it."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import resource
import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from threading import Thread
from typing import Any

from robotctl import environment
from robotctl.daemon import options as command_line
from robotctl.daemon.lock import owned
from robotctl.daemon.log import log_to_stderr
from robotctl.daemon.options import DaemonOptions
from robotctl.errors import INTERRUPTED_EXIT_CODE, RobotctlError
from robotctl.paths import lock_path
from robotctl.streams import open_standard_streams

_log = logging.getLogger("robotctl")


def main(arguments: list[str]) -> int:
    """Run a daemon to its end and return its exit code."""
    open_standard_streams()
    note = environment.prepare()
    with ExitStack() as at_end, log_to_stderr():
        return _main(arguments, [note] if note else [], at_end)


def _main(arguments: list[str], notes: list[str], at_end: ExitStack) -> int:
    """As `main`; what has to be the last, after the log too, is left to `at_end`."""
    ready_fd = command_line.parse_ready_fd(arguments)
    if ready_fd is not None:
        os.set_inheritable(ready_fd, False)
    _allow_many_files()
    try:
        options = command_line.parse(arguments)
        at_end.enter_context(owned(lock_path(options.robot), options.robot))
        _run(options, partial(_tell, ready_fd), notes, at_end)
    except RobotctlError as error:
        return _fail(ready_fd, error)
    except KeyboardInterrupt:  # before the loop took the signals over
        return INTERRUPTED_EXIT_CODE
    except OSError as error:
        where = f": {error.filename}" if error.filename else ""
        return _fail(ready_fd, RobotctlError(f"{error.strerror or error}{where}"))
    except Exception as error:  # noqa: BLE001 - a bug of ours: its traceback goes into the log only
        if ready_fd is not None:
            _log.exception("the daemon failed")
        return _fail(ready_fd, RobotctlError(f"unexpected {type(error).__name__}: {error}"))
    return 0


def _run(
    options: DaemonOptions,
    tell: Callable[[dict[str, Any]], None],
    notes: list[str],
    at_end: ExitStack,
) -> None:
    from robotctl.daemon.app import serve  # after environment.prepare(): it imports rclpy

    asyncio.run(serve(options, notes, tell, at_end))


def _allow_many_files() -> None:
    """Each recorded topic is one: the usual soft limit, 1024, is kept low for select(2) only."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def _fail(ready_fd: int | None, error: RobotctlError) -> int:
    if ready_fd is None:
        with suppress(OSError):  # nobody reads stderr
            print(f"robotctl: {error}", file=sys.stderr)
    else:
        _log.error("%s", error)
        failure = {"error": str(error), "exit_code": error.exit_code, **error.details()}
        _tell(ready_fd, {"ready": False, **failure})
    return error.exit_code


def _tell(ready_fd: int | None, said: dict[str, Any]) -> None:
    """Write the one line that a starting process waits for, or to stdout in the foreground."""
    line = f"{json.dumps(said)}\n".encode()
    if ready_fd is None:  # whoever has stdout may not read it: the loop must not wait for that
        Thread(target=_write, args=(1, line), daemon=True).start()
    elif _write(ready_fd, line):
        os.close(ready_fd)


def _write(descriptor: int, line: bytes) -> bool:
    try:
        os.write(descriptor, line)
    except OSError as error:  # told already, or the one who started us is gone
        _log.warning("nobody waited for READY: %s", error)
        return False
    return True


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
