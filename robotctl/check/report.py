"""The report and the verdict of checking a recording."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any, Final
from zlib import crc32

from robotctl import __version__
from robotctl.base.errors import Divergence as DivergenceError
from robotctl.base.errors import UnreadableFile
from robotctl.check.invariants import Violation
from robotctl.kernel.codec import to_json
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.state import State
from robotctl.recording.read.file_index import note_missing

TOLERANCE: Final = 1e-9
"""The tolerance, absolute and relative, for floats that a C library rounded."""

DIGITS: Final = 9
"""The number of significant digits in comparisons of two machines."""

_FLOAT: Final = re.compile(r"-?\d+\.\d+(?:e[-+]?\d+)?")


def rounded(text: str) -> str:
    """Return `text` with each float rounded to DIGITS significant digits."""
    return _FLOAT.sub(lambda number: f"{float(number[0]):.{DIGITS}g}", text)


@dataclass(frozen=True, slots=True)
class Divergence:
    """The first place where a new kernel decided differently.

    `seq` and `t_ns` (steady) are those of the recorded entry. `event` is the input; `recorded` and
    `decided` are the differing effects, "" if missing. All three have the form `Name {json}`.
    `before` is the new kernel's state before the event.
    """

    seq: int
    t_ns: int
    event: str
    recorded: str
    decided: str
    before: State | None
    differences: tuple[str, ...] = ()

    def sentence(self) -> str:
        """Return entry, event and differing fields in one sentence."""
        differs = "; ".join(self.differences)
        if not differs:
            differs = f"recorded {self.recorded or 'nothing'}, decided {self.decided or 'nothing'}"
        return f"entry {self.seq}, after {self.event.partition(' ')[0]}: {differs}"


class Verdict(StrEnum):
    """The result of a check, the most severe first."""

    DIVERGED = "diverged"
    """A new kernel of the recording's version decides differently."""

    BROKEN = "broken"
    """An invariant, the journal's CRC, the loss ledger or a message contradicts the decisions."""

    INCOMPLETE = "incomplete"
    """Not everything could be checked, or another version decided by other rules."""

    SAME = "same"

    @property
    def exit_code(self) -> int:
        """The exit code of `replay --check` with this result."""
        if self is Verdict.SAME:
            return 0
        return (UnreadableFile if self is Verdict.INCOMPLETE else DivergenceError).exit_code


@dataclass(slots=True)
class Report:
    """The result of checking one recording.

    The first journal entry was made at `begin_ns` (steady), recorded at `begin_log_ns` (epoch).
    """

    path: Path
    robot: str = ""
    version: str = ""
    """The version of robotctl that made the recording, "" if unknown."""

    made_by: str = ""
    """The arithmetic of the recording's floats, "" if unknown."""

    bitwise: bool = True
    events: int = 0
    effects: int = 0
    commands: int = 0
    duration_s: float = 0.0
    took_s: float = 0.0
    begin_ns: int = 0
    begin_log_ns: int = 0
    divergence: Divergence | None = None
    """The first difference, even in a recording of another version, or None."""

    divergences: int = 0
    """The number of divergences: at most one between two snapshots."""

    divergences_crc: int = 0
    """The CRC of the sentences of all divergences, with rounded numbers."""

    violations: list[Violation] = field(default_factory=list)
    violation_count: int = 0
    missing: list[str] = field(default_factory=list)
    """A sentence for each part that could not be checked."""

    notes: list[str] = field(default_factory=list)
    seal: str = ""
    """The signer of the recording and the state of the seal; "" without a seal."""

    has_other_format: bool = False
    """Whether the journal has other fields than the version that the recording names."""

    has_gaps: bool = field(default=False, init=False)
    """Whether a missing part of the recording may explain a difference."""

    _other_rules: bool = field(default=False, init=False)

    @property
    def same_version(self) -> bool:
        """Whether this version made the recording; in another one, a difference is no error."""
        return self.version == __version__ and not self.has_other_format

    @property
    def other_version(self) -> str:
        """The recorded version, plus "with other fields" if the journal does not fit it."""
        return f"{self.version} with other fields" if self.has_other_format else self.version

    @property
    def verdict(self) -> Verdict:
        """The result of the check; if several results apply, the most severe."""
        if self.divergence is not None and self.same_version:
            return Verdict.DIVERGED
        if self.violation_count:
            return Verdict.BROKEN
        return Verdict.INCOMPLETE if self.missing else Verdict.SAME

    def count_divergence(self, found: Divergence) -> None:
        """Count a divergence."""
        self.divergences += 1
        self.divergences_crc = crc32(rounded(found.sentence()).encode(), self.divergences_crc)

    def miss(self, sentence: str, *, is_outside: bool = False) -> None:
        """Add a sentence about something that could not be checked.

        Set `has_gaps`, unless the missing part is outside of what was checked (`is_outside`).
        """
        note_missing(self.missing, sentence)
        self.has_gaps |= not is_outside

    def miss_other_rules(self, difference: str) -> None:
        """Report a difference that is no error, in a recording of another version."""
        if self._other_rules:
            self.miss(difference)
            return
        self._other_rules = True
        theirs = self.other_version or "unknown"
        self.miss(
            f"decided by the rules of another version ({theirs}, this is {__version__}): "
            f"{difference}"
        )

    def moment(self, t_ns: int) -> dict[str, Any]:
        """Return a steady time in three forms: as is, in seconds from the start, and as a date."""
        after_ns = t_ns - self.begin_ns
        wall_s = (self.begin_log_ns + after_ns) / NS_PER_S
        try:
            at = datetime.fromtimestamp(wall_s, UTC).astimezone().isoformat(timespec="milliseconds")
        except (OverflowError, ValueError, OSError):  # outside the calendar
            at = ""
        return {"t_ns": t_ns, "after_s": after_ns / NS_PER_S, "at": at}

    def as_object(self) -> dict[str, Any]:
        """Return the report as the JSON object of `replay --check --json`."""
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
            "seal": self.seal,
        }
