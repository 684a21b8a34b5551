"""`python -m robotctl.replay --report-fd N`: play the job on stdin, and report progress on N.

Each report is one line of JSON with the key "note", "waiting", "start", "progress" or "summary", or
with "error", "exit_code" and details. More lines on stdin control the replay, and the end of stdin
stops it.
"""

from __future__ import annotations

import gc
import json
import os
import select
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from robotctl.base import environment
from robotctl.base.errors import RobotctlError
from robotctl.base.processes import LineSplitter, report_fd, send_report

if TYPE_CHECKING:
    from robotctl.replay.run import Emit
    from robotctl.ros.context import Membership

NODE_NAME = "robotctl_replay"

SWITCH_INTERVAL_S = 1e-4
"""The longest time [s] that the player's thread waits for the GIL. Python's default is 5 ms."""


def main(arguments: list[str]) -> int:
    """Play one job and return the exit code."""
    with ExitStack() as at_end:
        return _main(arguments, at_end)


def _main(arguments: list[str], at_end: ExitStack) -> int:
    """Play one job, and push what must be closed last to `at_end`."""
    note = environment.prepare()
    emit = partial(_emit, report_fd(arguments))
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.disable()  # until playback: imports make no garbage
    debug = False
    try:
        # After environment.prepare(), because it imports rclpy; before the wait for the job.
        from robotctl.ros.context import Membership

        lines = _lines()
        line = next(lines, b"")
        if not line:
            return 0
        request = json.loads(line)
        debug = request["debug"]
        if note:
            emit({"note": note})
        membership = at_end.enter_context(Membership(request["domain_id"], NODE_NAME))
        _play(line.decode(), membership, lines, emit)
    except RobotctlError as error:
        emit({"error": str(error), "exit_code": error.exit_code, **error.details()})
        return error.exit_code
    except Exception as error:  # noqa: BLE001 - show a traceback only with --debug
        if debug:
            traceback.print_exc()
        text = f"unexpected {type(error).__name__}: {error}"
        emit({"error": text, "exit_code": RobotctlError.exit_code})
        return RobotctlError.exit_code
    return 0


def _play(job: str, membership: Membership, lines: Iterator[bytes], emit: Emit) -> None:
    """Play `job`, a line from `Job.to_json`, under the commands in `lines`."""
    # Discovery goes on during these imports.
    from robotctl.replay.job import Job
    from robotctl.replay.playback_control import command_of
    from robotctl.replay.run import Replay
    from robotctl.ros.playback import ReplaySession

    replay = Replay(Job.from_json(job), ReplaySession(membership), emit)

    def obey() -> None:
        for line in lines:
            command = command_of(line)
            if command is not None:
                replay.control(command)
        replay.stop()

    threading.Thread(target=obey, name="stdin", daemon=True).start()
    replay.run()


def _lines() -> Iterator[bytes]:
    """Yield the lines of stdin."""
    # Unbuffered: a blocked buffered read delays the exit.
    lines = LineSplitter()
    while piece := os.read(0, 1 << 16):
        yield from lines.feed(piece)


def _emit(descriptor: int, message: dict[str, Any]) -> None:
    """Write a report. Drop it if the pipe is closed, or if it is progress for a slow reader."""
    # Waiting would delay the safety checks.
    if "progress" in message and not select.select([], [descriptor], [], 0)[1]:
        return
    with suppress(BrokenPipeError):
        send_report(descriptor, message)


if __name__ == "__main__":
    code = main(sys.argv[1:])
    os._exit(code)  # the ROS domain is left already; a destructor of Fast DDS sleeps 0.1 s
