"""Every error that a user may meet; each class owns its exit code.

    RobotctlError            1   internal, unexpected
    |-- UsageError           2   a wrong argument
    |   `-- ConfigError      2   a wrong configuration file or key
    |-- NoDaemon             3   no daemon answers for this robot
    |-- Refused              4   a condition does not hold; nothing was changed
    |-- AlreadyRunning       5   another process owns this robot
    |-- UnreadableFile       6   nothing can be read from the file
    |-- Divergence           7   a re-run decided differently from the recording
    `-- RecoveredWithLoss    8   salvaged, but not everything

An error's text says what happened and what to do about it, without a traceback.
"""

from __future__ import annotations

from typing import ClassVar

INTERRUPTED_EXIT_CODE = 130


class RobotctlError(Exception):
    """Root of the tree: something that robotctl itself got wrong."""

    exit_code: ClassVar[int] = 1


class UsageError(RobotctlError):
    """An argument is outside what is allowed."""

    exit_code = 2


class ConfigError(UsageError):
    """A configuration file is missing, malformed, or holds a value outside its limits."""


class NoDaemon(RobotctlError):
    """No daemon answers on the robot's socket."""

    exit_code = 3


class Refused(RobotctlError):
    """A condition does not hold; the text names it and the cure."""

    exit_code = 4


class AlreadyRunning(RobotctlError):
    """Another process owns the robot's name; the text names its pid."""

    exit_code = 5


class UnreadableFile(RobotctlError):
    """Nothing can be read from the file."""

    exit_code = 6


class Divergence(RobotctlError):
    """A fresh kernel decided differently from the recorded one."""

    exit_code = 7


class RecoveredWithLoss(RobotctlError):
    """A broken file was salvaged, but not all of it."""

    exit_code = 8


def error_for_exit_code(exit_code: int, text: str) -> RobotctlError:
    """Rebuild the error that crossed a process boundary as (exit code, text)."""
    kinds = (NoDaemon, Refused, AlreadyRunning, UnreadableFile, Divergence, RecoveredWithLoss)
    known = {kind.exit_code: kind for kind in (*kinds, UsageError)}
    return known.get(exit_code, RobotctlError)(text)
