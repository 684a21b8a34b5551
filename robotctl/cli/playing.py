"""The process that plays a recording: started, heard and ended from the command line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from robotctl.errors import RobotctlError, error_for_exit_code
from robotctl.replay.job import Job

PLAYER = (sys.executable, "-P", "-m", "robotctl.replay")
"""-P: what lies in the working directory is not imported in place of a library."""

END_DEADLINE_S = 15.0
"""For the player to take its publishers off the graph and leave."""


@dataclass(slots=True)
class Outcome:
    """What came of a replay, as far as is known."""

    summary: dict[str, Any] = field(default_factory=dict)
    error: RobotctlError | None = None
    interrupted: bool = False
    ended: bool = False
    """The player has nothing more to say."""


def play(job: Job, outcome: Outcome, show: Callable[[dict[str, Any]], None]) -> None:
    """Have a process play the job and show what it says; the first Ctrl-C asks it to end."""
    process = subprocess.Popen(
        PLAYER,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        process_group=0,  # a Ctrl-C is ours to pass on: it may come while Python starts there
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        os.write(process.stdin.fileno(), f"{job.to_json()}\n".encode())
        while not outcome.ended:
            try:
                _take(process.stdout.readline(), outcome, show)
            except KeyboardInterrupt:
                if outcome.interrupted:
                    raise
                outcome.interrupted = True
                process.stdin.close()
    except BrokenPipeError:
        outcome.ended = True
    finally:
        process.stdin.close()
        process.stdout.close()
        try:
            process.wait(END_DEADLINE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    if not (outcome.summary or outcome.error or outcome.interrupted):
        raise RobotctlError(
            f"the player ended with {process.returncode} before the replay did "
            "(see why with: robotctl --debug replay ...)"
        )


def _take(line: bytes, outcome: Outcome, show: Callable[[dict[str, Any]], None]) -> None:
    if not line:
        outcome.ended = True
        return
    try:
        said = json.loads(line)
    except ValueError:  # the rest of a line that a Ctrl-C has cut
        return
    if "error" in said:
        outcome.error = error_for_exit_code(said["exit_code"], said["error"])
    outcome.summary = said.get("summary", outcome.summary)
    show(said)
