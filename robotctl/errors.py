"""Every error that a user may meet; each class owns its exit code.

    RobotctlError            1   internal, unexpected
    |-- UsageError           2   a wrong argument
    |   `-- ConfigError      2   a wrong configuration file or key
    |-- NoDaemon             3   no daemon answers for this robot
    |-- Refused              4   a condition does not hold; nothing was changed
    |-- AlreadyRunning       5   another process owns this robot
    |-- UnreadableFile       6   nothing can be read from the file
    |-- Divergence           7   a re-run decided differently from the recording
    |-- RecoveredWithLoss    8   salvaged, but not everything
    `-- Interrupted        130   ended by Ctrl-C or a signal

An error's text says what happened and what to do about it, without a traceback.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

INTERRUPTED_EXIT_CODE = 130

IN_PARENTHESES = "{cause} ({cure})"
"""The sentence of an error whose cure stands behind its cause."""


class RobotctlError(Exception):
    """Root of the tree: something that robotctl itself got wrong.

    `str(error)` is the sentence for people. `cause` is what happened, `cure` what to do about it;
    where `cure` is empty, `cause` may tell both. `answer` is what was found all the same: the
    numbers of a drive that was stopped, the readable part of a damaged file.
    """

    exit_code: ClassVar[int] = 1
    kind: ClassVar[str] = "internal"
    """The name of the exit code for machines; it never changes."""

    def __init__(
        self,
        cause: str = "",
        cure: str = "",
        *,
        sentence: str = "{cause}: {cure}",
        answer: Mapping[str, Any] | None = None,
    ) -> None:
        """`sentence` joins cause and cure."""
        super().__init__(sentence.format(cause=cause, cure=cure) if cure else cause)
        self.cause = cause
        self.cure = cure
        self.answer: Mapping[str, Any] = answer or {}

    def details(self) -> dict[str, Any]:
        """Return what crosses a process boundary beside exit code and text."""
        details: dict[str, Any] = {}
        if self.cure:
            details |= {"cause": self.cause, "cure": self.cure}
        if self.answer:
            details["answer"] = dict(self.answer)
        return details

    def as_object(self) -> dict[str, Any]:
        """Return what `--json` prints as `error`."""
        return {
            "kind": self.kind,
            "message": str(self) or self.kind,
            "cause": self.cause or self.kind,
            "cure": self.cure or None,
            "exit_code": self.exit_code,
        }


class UsageError(RobotctlError):
    """An argument is outside what is allowed."""

    exit_code = 2
    kind = "usage"


class ConfigError(UsageError):
    """A configuration file is missing, malformed, or holds a value outside its limits."""


class NoDaemon(RobotctlError):
    """No daemon answers on the robot's socket."""

    exit_code = 3
    kind = "no_daemon"


class Refused(RobotctlError):
    """A condition does not hold; the text names it and the cure."""

    exit_code = 4
    kind = "refused"


class AlreadyRunning(RobotctlError):
    """Another process owns the robot's name; the text names its pid."""

    exit_code = 5
    kind = "already_running"


class UnreadableFile(RobotctlError):
    """Nothing can be read from the file."""

    exit_code = 6
    kind = "unreadable_file"


class Divergence(RobotctlError):
    """A fresh kernel decided differently from the recorded one."""

    exit_code = 7
    kind = "divergence"


class RecoveredWithLoss(RobotctlError):
    """A broken file was salvaged, but not all of it."""

    exit_code = 8
    kind = "recovered_with_loss"


class Interrupted(RobotctlError):
    """The command was ended from outside; an empty text is not shown to people."""

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
    """Rebuild the error that crossed a process boundary as exit code, text and `details()`.

    Details of another form, such as those of another version, are left out.
    """
    kinds = {kind.exit_code: kind for kind in _KINDS}
    error = kinds.get(exit_code, RobotctlError)(text)
    details = details or {}
    cause, cure, answer = (details.get(name) for name in ("cause", "cure", "answer"))
    if isinstance(cause, str) and isinstance(cure, str):
        error.cause, error.cure = cause or text, cure
    if isinstance(answer, dict):
        error.answer = answer
    return error
