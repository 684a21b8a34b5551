"""What other parts of robotctl found about a recording, as its report shows it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Tone(StrEnum):
    """What a verdict means for a reader."""

    GOOD = "good"
    UNSURE = "unsure"
    """Nothing is wrong, but not everything is proved."""

    BAD = "bad"


@dataclass(frozen=True, slots=True)
class CommandVerdict:
    """A verdict: by which command, the verdict in a word, what it means, and its sentences."""

    command: str
    verdict: str
    tone: Tone
    sentences: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Explanation:
    """Why the robot was stopped, or why something was refused: rows of a label and a sentence."""

    t_s: float
    what: str
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class ReportFindings:
    """All that was found."""

    judgements: tuple[CommandVerdict, ...] = ()
    explanations: tuple[Explanation, ...] = ()
