"""`python -m robotctl.replay`: plays the job that comes on stdin, and tells how it goes on stdout.

One line of JSON each: {"note"}, {"start"}, {"progress"}, {"summary"}, and {"error", "exit_code"}.
Anything more on stdin, its end among it, stops the replay: it never outlives who asked for it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import traceback
from contextlib import suppress
from typing import Any

from robotctl import environment
from robotctl.errors import RobotctlError
from robotctl.replay.job import Job

SWITCH_INTERVAL_S = 1e-4
"""How long the thread that keeps time waits for another one to let it go on (default 5 ms)."""


def main() -> int:
    """Play one job and return the exit code."""
    note = environment.prepare()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    job = Job.from_json(sys.stdin.readline())
    if note:
        _tell({"note": note})
    from robotctl.replay.session import Replay  # after environment.prepare(): it imports rclpy

    replay = Replay(job, _tell)

    def stop_with_parent() -> None:
        os.read(sys.stdin.fileno(), 1)
        replay.stop()

    threading.Thread(target=stop_with_parent, name="stdin", daemon=True).start()
    try:
        replay.run()
    except RobotctlError as error:
        _tell({"error": str(error), "exit_code": error.exit_code})
        return error.exit_code
    except Exception as error:  # noqa: BLE001 - no traceback reaches a user who did not ask for it
        if job.debug:
            traceback.print_exc()
        text = f"unexpected {type(error).__name__}: {error}"
        _tell({"error": text, "exit_code": RobotctlError.exit_code})
        return RobotctlError.exit_code
    return 0


def _tell(said: dict[str, Any]) -> None:
    """Write a line; where nobody listens any more, stdin has ended as well."""
    with suppress(BrokenPipeError):
        os.write(sys.stdout.fileno(), f"{json.dumps(said)}\n".encode())


if __name__ == "__main__":
    sys.exit(main())
