"""`python -m robotctl.replay --report-fd N`: plays the job on stdin, and tells on N how it goes.

One line of JSON each: {"note"}, {"waiting"}, {"start"}, {"progress"}, {"summary"}, and {"error",
"exit_code"} with the error's details. Further lines on stdin control the replay
(robotctl.replay.commands), and its end stops it: a replay never outlives who asked for it.
"""

from __future__ import annotations

import os
import select
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from robotctl import environment
from robotctl.errors import RobotctlError
from robotctl.processes import LineSplitter, report_fd, send_report
from robotctl.replay.job import Job
from robotctl.replay.other_daemons import domain_of

if TYPE_CHECKING:
    from robotctl.replay.report import Tell

SWITCH_INTERVAL_S = 1e-4
"""How long the thread that keeps time waits for another one to let it go on (default 5 ms)."""


def main(arguments: list[str]) -> int:
    """Play one job and return the exit code."""
    with ExitStack() as at_end:
        return _main(arguments, at_end)


def _main(arguments: list[str], at_end: ExitStack) -> int:
    """As `main`; what has to be the last is left to `at_end`."""
    note = environment.prepare()
    tell = partial(_tell, report_fd(arguments))
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    lines = _lines()
    job = Job.from_json(next(lines, b"").decode())
    if note:
        tell({"note": note})
    try:
        _play(job, lines, tell, at_end)
    except RobotctlError as error:
        tell({"error": str(error), "exit_code": error.exit_code, **error.details()})
        return error.exit_code
    except Exception as error:  # noqa: BLE001 - no traceback reaches a user who did not ask for it
        if job.debug:
            traceback.print_exc()
        text = f"unexpected {type(error).__name__}: {error}"
        tell({"error": text, "exit_code": RobotctlError.exit_code})
        return RobotctlError.exit_code
    return 0


def _play(job: Job, lines: Iterator[bytes], tell: Tell, at_end: ExitStack) -> None:
    """Play a job, as the lines say."""
    # After environment.prepare(): it imports rclpy.
    from robotctl.ros.playback.membership import Membership

    membership = at_end.enter_context(Membership(domain_of(job)))
    # Others are discovered while this is imported.
    from robotctl.replay.commands import command_of
    from robotctl.replay.run import Replay
    from robotctl.ros.playback.playback import ReplaySession

    replay = Replay(job, ReplaySession(membership), tell)

    def obey() -> None:
        for line in lines:
            command = command_of(line)
            if command is not None:
                replay.control(command)
        replay.stop()

    threading.Thread(target=obey, name="stdin", daemon=True).start()
    replay.run()


def _lines() -> Iterator[bytes]:
    """The lines of stdin; not buffered: a thread that waits in a buffer hinders the exit."""
    lines = LineSplitter()
    while piece := os.read(sys.stdin.fileno(), 1 << 16):
        yield from lines.feed(piece)


def _tell(descriptor: int, said: dict[str, Any]) -> None:
    """Write a line; where nobody listens any more, stdin has ended as well.

    Progress is dropped where the reader does not keep up: it must not hold up the safety checks.
    """
    if "progress" in said and not select.select([], [descriptor], [], 0)[1]:
        return
    with suppress(BrokenPipeError):
        send_report(descriptor, said)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
