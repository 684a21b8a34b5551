"""What came of the check of a recording."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from robotctl import __version__
from robotctl.errors import Divergence as DivergenceError
from robotctl.errors import UnreadableFile
from robotctl.kernel.codec import to_json
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.read.file_index import note_missing
from robotctl.rerun.invariants import Violation
from robotctl.rerun.rerun import Divergence


class Verdict(StrEnum):
    """What came of a check, the gravest first."""

    DIVERGED = "diverged"
    """A fresh kernel of the version that made the recording decides otherwise."""

    BROKEN = "broken"
    """It decides the same, but the recording breaks a promise of robotctl."""

    INCOMPLETE = "incomplete"
    """Not everything could be checked, or another version decided by other rules; the rest is in
    order."""

    SAME = "same"

    @property
    def exit_code(self) -> int:
        """Of a command that has nothing graver to tell."""
        if self is Verdict.SAME:
            return 0
        return (UnreadableFile if self is Verdict.INCOMPLETE else DivergenceError).exit_code


@dataclass(slots=True)
class Report:
    """The check of one recording.

    `version` and `made_by` are of the recording, "" where it does not say; `missing` says what
    could not be checked, `notes` how the rest was; times in seconds, and steady ns for `begin_ns`,
    which is `begin_log_ns` since the epoch. `divergence` is the first difference, also where the
    recording is of another version.
    """

    path: Path
    robot: str = ""
    version: str = ""
    made_by: str = ""
    bitwise: bool = True
    events: int = 0
    effects: int = 0
    commands: int = 0
    duration_s: float = 0.0
    took_s: float = 0.0
    begin_ns: int = 0
    begin_log_ns: int = 0
    divergence: Divergence | None = None
    violations: list[Violation] = field(default_factory=list)
    violation_count: int = 0
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _other_rules: bool = field(default=False, init=False)

    @property
    def same_version(self) -> bool:
        """Whether this very version made the recording: only then a difference is a fault."""
        return self.version == __version__

    @property
    def verdict(self) -> Verdict:
        """The gravest of what was found."""
        if self.divergence is not None and self.same_version:
            return Verdict.DIVERGED
        if self.violation_count:
            return Verdict.BROKEN
        return Verdict.INCOMPLETE if self.missing else Verdict.SAME

    def miss(self, sentence: str) -> None:
        """Say that something could not be checked."""
        note_missing(self.missing, sentence)

    def miss_other_rules(self, difference: str) -> None:
        """Say where another version decided by other rules; the first sentence names both."""
        if self._other_rules:
            self.miss(difference)
            return
        self._other_rules = True
        theirs = self.version or "unknown"
        self.miss(
            f"decided by the rules of another version ({theirs}, this is {__version__}): "
            f"{difference}"
        )

    def moment(self, t_ns: int) -> dict[str, Any]:
        """A steady time, in seconds after the recording's beginning and as a date with a time."""
        after_ns = t_ns - self.begin_ns
        wall_s = (self.begin_log_ns + after_ns) / NS_PER_S
        try:
            at = datetime.fromtimestamp(wall_s, UTC).astimezone().isoformat(timespec="milliseconds")
        except (OverflowError, ValueError, OSError):  # a time that nobody has a calendar for
            at = ""
        return {"t_ns": t_ns, "after_s": after_ns / NS_PER_S, "at": at}

    def as_object(self) -> dict[str, Any]:
        """The report as plain values, for machines."""
        found = self.divergence
        return {
            "path": str(self.path),
            "verdict": self.verdict.value,
            "robot": self.robot,
            "version": self.version,
            "made_by": self.made_by,
            "bitwise": self.bitwise,
            "events": self.events,
            "effects": self.effects,
            "commands": self.commands,
            "duration_s": self.duration_s,
            "took_s": self.took_s,
            "divergence": None
            if found is None
            else {
                "seq": found.seq,
                **self.moment(found.t_ns),
                "event": found.event,
                "recorded": found.recorded,
                "decided": found.decided,
                "differences": list(found.differences),
                "mode": found.before.mode.name if found.before else None,
                "state": json.loads(to_json(found.before)) if found.before else None,
            },
            "violations": [
                {"seq": each.seq, **self.moment(each.t_ns), "text": each.text}
                for each in self.violations
            ],
            "violation_count": self.violation_count,
            "missing": self.missing,
            "notes": self.notes,
        }
