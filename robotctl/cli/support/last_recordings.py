"""The last recordings of a robot, with all that was recorded until now."""

from __future__ import annotations

from pathlib import Path

from robotctl.cli.support.recording_paths import recordings_of, robot_of
from robotctl.errors import NoDaemon, Refused, RobotctlError, UsageError
from robotctl.ipc.answers import Committed
from robotctl.ipc.client import Client
from robotctl.ipc.method_names import RECORD_COMMIT

MAX_RECORDINGS = 20
"""How many recordings are searched; reading a journal takes seconds per recorded hour."""

COMMIT_DEADLINE_S = 8.0
"""Longer than the daemon's own deadline, so that its answer names what was not written."""


def committed_recording(robot: str, missing: list[str]) -> Path | None:
    """Let the robot's daemon commit its recording, and return the folder; None without a daemon.

    `missing` gets a sentence about messages that the daemon did not write.
    """
    try:
        with Client(robot) as client:
            answer = _commit(client, missing)
    except (NoDaemon, Refused, UsageError):  # no daemon, or not a valid robot name
        return None
    return None if answer is None else Path(answer["file"]).parent


def with_earlier(newest: Path) -> list[Path]:
    """Return a recording and the earlier ones of its robot beside it, newest first."""
    paths = recordings_of(robot_of(newest), newest.parent)
    if newest not in paths:
        return [newest]
    return paths[paths.index(newest) :][:MAX_RECORDINGS]


def _commit(client: Client, missing: list[str]) -> Committed | None:
    try:
        answer = client.call(RECORD_COMMIT, deadline_s=COMMIT_DEADLINE_S)
    except RobotctlError as error:  # busy, stuck, ending, or of another version
        missing.append(f"the messages that the daemon has not written yet: {error}")
        return None
    if answer["uncommitted"]:
        reason = answer["failure"] or "the disk is too slow"
        missing.append(f"{answer['uncommitted']} messages that are not written yet: {reason}")
    return answer
