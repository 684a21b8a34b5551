"""One thing that was looked at, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Level(Enum):
    """How bad a finding is."""

    OK = "ok"
    WARNING = "warning"
    """Something may fail, or be slow."""
    FAULT = "fault"
    """Something does not work."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found: `check` names what was looked at; `text` and `cure` are a sentence each."""

    check: str
    level: Level
    text: str
    cure: str = ""

    def as_object(self) -> dict[str, str | None]:
        """Return what `--json` prints."""
        return {
            "check": self.check,
            "level": self.level.value,
            "text": self.text,
            "cure": self.cure or None,
        }


def ok(check: str, text: str) -> Finding:
    """Return a finding of something that is as it should be."""
    return Finding(check, Level.OK, text)


def warning(check: str, text: str, cure: str) -> Finding:
    """Return a finding of something that may fail."""
    return Finding(check, Level.WARNING, text, cure)


def fault(check: str, text: str, cure: str) -> Finding:
    """Return a finding of something that does not work."""
    return Finding(check, Level.FAULT, text, cure)
