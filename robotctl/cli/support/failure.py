"""Report why a command failed: one sentence, one JSON object, one exit code."""

from __future__ import annotations

import errno
import os
import sys
from typing import TextIO

from robotctl.cli.terminal.text import json_text, printable
from robotctl.errors import IN_PARENTHESES, Interrupted, RobotctlError, UsageError


def report(error: BaseException, *, as_json: bool) -> int:
    """Print why a command failed, and return the exit code of its process.

    The sentence for people goes to stderr. With `as_json`, stdout gets one object as well: the
    partial answer, and `error`.
    """
    failure = _as_robotctl_error(error)
    if as_json:
        try:
            print(json_text({**failure.answer, "error": failure.as_object()}), flush=True)
        except OSError:
            drop_output(sys.stdout)
    if str(failure):
        try:
            print(f"robotctl: {printable(failure)}", file=sys.stderr, flush=True)
        except OSError:
            drop_output(sys.stderr)
    return failure.exit_code


def drop_output(stream: TextIO) -> None:
    """Discard what `stream` has buffered.

    Otherwise Python would try to write it again at exit, and exit with 120.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _as_robotctl_error(error: BaseException) -> RobotctlError:
    if isinstance(error, RobotctlError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Interrupted()
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        if error.filename is None:
            drop_output(sys.stdout)
        return RobotctlError(
            f"no space left on the disk for {error.filename or 'the output'}", "free some"
        )
    if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
        return RobotctlError("too many open files", "raise the limit (ulimit -n)")
    if isinstance(error, OSError) and error.errno == errno.ENOENT and _is_working_folder_gone():
        return UsageError("the working folder was removed", "cd to a folder that exists")
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return RobotctlError(f"{error.filename}: {error.strerror}")
    return RobotctlError(
        f"unexpected {type(error).__name__}: {error}",
        "see where with: robotctl --debug ...",
        sentence=IN_PARENTHESES,
    )


def _is_working_folder_gone() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return True
    return False
