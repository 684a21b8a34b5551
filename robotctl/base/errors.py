"""The errors that users can see, with the exit code of each class.

The text of an error says what happened and what to do about it.
    RobotctlError            1   internal, unexpected
    |-- UsageError           2   a wrong argument
    |   `-- ConfigError      2   a wrong configuration file or key
    |-- NoDaemon             3   no daemon answers for this robot
    |-- Refused              4   a condition does not hold; nothing was changed
    |-- NotSealed            4   no signature proves the origin of a recording
    |-- AlreadyRunning       5   another process owns this robot
    |-- UnreadableFile       6   nothing, or not everything, can be read from the file
    |-- Divergence           7   a re-run decided differently from the recording
    |-- RecoveredWithLoss    8   a file was recovered, but not all of it
    `-- Interrupted        130   ended by Ctrl-C or a signal
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

INTERRUPTED_EXIT_CODE = 130

IN_PARENTHESES = "{cause} ({cure})"
"""The format of an error text with the cure in parentheses after the cause."""


class RobotctlError(Exception):
    """The base class of all errors, and the class of internal errors.

    `cause` describes the error, and `cure` is the advice; if `cure` is empty, `cause` may contain
    both. `answer` is the partial result, such as the readable part of a damaged file.
    """

    exit_code: ClassVar[int] = 1
    kind: ClassVar[str] = "internal"
    """The name of the exit code in `--json`; it never changes."""

    def __init__(
        self,
        cause: str = "",
        cure: str = "",
        *,
        sentence: str = "{cause}: {cure}",
        answer: Mapping[str, Any] | None = None,
    ) -> None:
        """Format the text from `cause` and `cure` by `sentence`; without a cure, use `cause`."""
        super().__init__(sentence.format(cause=cause, cure=cure) if cure else cause)
        self.cause = cause
        self.cure = cure
        self.answer: Mapping[str, Any] = answer or {}

    def details(self) -> dict[str, Any]:
        """Return the fields that are sent to another process along with exit code and text."""
        details: dict[str, Any] = {}
        if self.cure:
            details |= {"cause": self.cause, "cure": self.cure}
        if self.answer:
            details["answer"] = dict(self.answer)
        return details

    def as_object(self) -> dict[str, Any]:
        """Return the object `error` in the output of `--json`."""
        return {
            "kind": self.kind,
            "message": str(self) or self.kind,
            "cause": self.cause or self.kind,
            "cure": self.cure or None,
            "exit_code": self.exit_code,
        }


class UsageError(RobotctlError):
    """An argument is not allowed."""

    exit_code = 2
    kind = "usage"


class ConfigError(UsageError):
    """A configuration file is missing, malformed, or has a value that is not allowed."""


class NoDaemon(RobotctlError):
    """No daemon answers a request on the robot's socket."""

    exit_code = 3
    kind = "no_daemon"


class Refused(RobotctlError):
    """A condition does not hold; nothing was changed."""

    exit_code = 4
    kind = "refused"


class NotSealed(RobotctlError):
    """A recording is whole, but no signature proves its origin."""

    exit_code = 4
    kind = "not_sealed"


class AlreadyRunning(RobotctlError):
    """Another process has the robot's lock or socket."""

    exit_code = 5
    kind = "already_running"


class UnreadableFile(RobotctlError):
    """A file cannot be read, or not completely."""

    exit_code = 6
    kind = "unreadable_file"


class Divergence(RobotctlError):
    """A re-run decided differently from the recording, or a check found something wrong in it."""

    exit_code = 7
    kind = "divergence"


class RecoveredWithLoss(RobotctlError):
    """A damaged file was recovered, but not completely."""

    exit_code = 8
    kind = "recovered_with_loss"


class Interrupted(RobotctlError):
    """Ctrl-C or a signal ended a command; an empty text is not printed."""

    exit_code = INTERRUPTED_EXIT_CODE
    kind = "interrupted"


_KINDS = (
    UsageError,
    NoDaemon,
    Refused,
    AlreadyRunning,
    UnreadableFile,
    Divergence,
    RecoveredWithLoss,
    Interrupted,
)


def error_for_exit_code(
    exit_code: int, text: str, details: Mapping[str, Any] | None = None
) -> RobotctlError:
    """Return the error of another process, made of its exit code, text and `details()`."""
    error = {kind.exit_code: kind for kind in _KINDS}.get(exit_code, RobotctlError)(text)
    details = details or {}
    cause, cure, answer = (details.get(name) for name in ("cause", "cure", "answer"))
    if isinstance(cause, str) and isinstance(cure, str):
        error.cause, error.cure = cause or text, cure
    if isinstance(answer, dict):
        error.answer = answer
    return error
