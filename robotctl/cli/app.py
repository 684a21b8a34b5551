"""The console script: one command line in, one exit code out, every error mapped here.

Imports stand where an interruption of them is caught: half of a quick command's time is theirs.
"""

from __future__ import annotations

import errno
import os
import sys

from robotctl.errors import INTERRUPTED_EXIT_CODE, RobotctlError
from robotctl.streams import open_standard_streams


def main() -> None:
    """Entry point of `robotctl`."""
    open_standard_streams()
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Carry out one command line and return the exit code of its process."""
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    # A process may be started with either closed.
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or sys.stdout
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a path may hold what the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    try:
        from robotctl.cli import quick

        command = quick.match(arguments)
        if command is not None:
            command()
        else:
            from robotctl.cli.commands import dispatch

            dispatch(arguments or ["--help"])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has seen enough
        _drop_output()
    except KeyboardInterrupt:
        return INTERRUPTED_EXIT_CODE
    except Exception as error:  # no traceback reaches a user who did not ask for it
        if debug:
            raise
        return _report(error)
    return 0


def _drop_output() -> None:
    """Let what is still to be written vanish: Python tries again when it ends, and complains."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _report(error: Exception) -> int:
    from robotctl.cli.text import printable

    if isinstance(error, RobotctlError):
        text, exit_code = str(error), error.exit_code
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        text = f"no space left on the disk for {error.filename or 'the output'}: free some"
        exit_code = RobotctlError.exit_code
        if error.filename is None:
            _drop_output()
    else:
        kind = type(error).__name__
        text = f"unexpected {kind}: {error} (see where with: robotctl --debug ...)"
        exit_code = RobotctlError.exit_code
    print(f"robotctl: {printable(text)}", file=sys.stderr)
    return exit_code
