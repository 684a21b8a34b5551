"""The console script: one command line in, one exit code out, every error mapped here.

Imports stand where an interruption of them is caught: half of a quick command's time is theirs.
"""

from __future__ import annotations

import os
import sys

from robotctl.streams import open_standard_streams


def main() -> None:
    """Entry point of `robotctl`."""
    open_standard_streams()
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Carry out one command line and return the exit code of its process."""
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    as_json = _wants_json(arguments)  # a parser takes the list apart
    # A process may be started with either closed.
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a path may hold what the terminal cannot show
            stream.reconfigure(errors="backslashreplace")
    try:
        from robotctl.cli import quick

        command = quick.match(arguments)
        if command is not None:
            command()
        else:
            from robotctl.cli.registry import dispatch

            dispatch(arguments or ["--help"])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has seen enough
        from robotctl.cli.support.failure import drop_output

        drop_output(sys.stdout)
    except (Exception, KeyboardInterrupt) as error:  # no traceback unless it was asked for
        if debug and not isinstance(error, KeyboardInterrupt):
            raise
        from robotctl.cli.support.failure import report

        return report(error, as_json=as_json)
    return 0


def _wants_json(arguments: list[str]) -> bool:
    """Whether stdout is read by a machine, also where the rest of the line makes no sense."""
    options = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return "--json" in options
