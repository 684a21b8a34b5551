"""The console script: runs one command line and maps every error to an exit code."""

from __future__ import annotations

import gc
import os
import sys

from robotctl.base.own_process import open_standard_streams


def main() -> None:
    """Run the command line of this process, and exit."""
    open_standard_streams()
    gc.disable()  # imports make no garbage; collection slows them by a tenth
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command line, and return the exit code."""
    debug = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    options = arguments[: arguments.index("--")] if "--" in arguments else arguments
    as_json = "--json" in options  # even if the rest of the line cannot be parsed
    # Python sets a stream to None if it was closed when the process started.
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a path may contain characters that the terminal lacks
            stream.reconfigure(errors="backslashreplace")
    try:  # around the imports, too: they are half of a quick command, and Ctrl-C may interrupt them
        if arguments[:1] and arguments[0].startswith("--"):
            arguments = behind_the_command(arguments)
        from robotctl.cli import quick

        command = quick.match(arguments)
        if command is not None:
            command()
        else:
            _parse_and_run(arguments or ["--help"])
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has closed it
        from robotctl.cli.ui.output import drop_output

        drop_output(sys.stdout)
    except (Exception, KeyboardInterrupt) as error:  # a traceback only with --debug
        if debug and not isinstance(error, KeyboardInterrupt):
            raise
        from robotctl.cli.ui.output import report

        return report(error, as_json=as_json)
    return 0


def _parse_and_run(arguments: list[str]) -> None:
    """Run a command line through the option parser."""
    from robotctl.cli.registry import dispatch

    gc.freeze()
    gc.enable()
    dispatch(arguments)


ENDS_OF_OPTIONS = ("--", "--ros-args")
"""The words that end the options of the command."""


def behind_the_command(arguments: list[str]) -> list[str]:
    """Move --robot and --json from before the command to the end of its options.

    `--robot r2 topic list` becomes `topic list --robot r2`. With another option before the command,
    nothing moves.
    """
    at = 0
    while at < len(arguments):
        if arguments[at] == "--json" or arguments[at].startswith("--robot="):
            at += 1
        elif arguments[at] == "--robot":
            at += 2
        else:
            break
    leading, rest = arguments[:at], arguments[at:]
    if not rest or rest[0].startswith("-"):
        return arguments
    end = min((rest.index(word) for word in ENDS_OF_OPTIONS if word in rest), default=len(rest))
    return rest[:end] + leading + rest[end:]
