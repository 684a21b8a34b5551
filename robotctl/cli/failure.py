"""What a command failed of, whatever was raised: one sentence, one object, one exit code."""

from __future__ import annotations

import errno
import os
import sys

from robotctl.cli.text import json_text, printable
from robotctl.errors import IN_PARENTHESES, Interrupted, RobotctlError, UsageError


def report(error: BaseException, *, as_json: bool) -> int:
    """Show why a command failed, and return the exit code of its process.

    People get a sentence on stderr. With `as_json`, stdout gets one object as well: what was found
    all the same, and `error`.
    """
    failure = _as_robotctl_error(error)
    if as_json:
        try:
            print(json_text({**failure.answer, "error": failure.as_object()}), flush=True)
        except OSError:
            drop_output()
    if as_json and sys.stderr is sys.stdout:  # was closed
        return failure.exit_code
    if str(failure):
        print(f"robotctl: {printable(failure)}", file=sys.stderr)
    return failure.exit_code


def drop_output() -> None:
    """Discard what is still to be written: Python tries again when it ends, and complains."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _as_robotctl_error(error: BaseException) -> RobotctlError:
    if isinstance(error, RobotctlError):
        return error
    if isinstance(error, KeyboardInterrupt):
        return Interrupted()
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        if error.filename is None:
            drop_output()
        return RobotctlError(
            f"no space left on the disk for {error.filename or 'the output'}", "free some"
        )
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
