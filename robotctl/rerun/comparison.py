"""Compares a decision with the recorded one: exactly, or with the tolerance that is needed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

import msgspec

from robotctl import __version__
from robotctl.kernel.codec import to_json
from robotctl.kernel.types import Decision
from robotctl.recording.format.metadata_names import MADE_BY

TOLERANCE = 1e-9
"""The tolerance, absolute and relative, for floats of another libc or Python."""

WORDING = frozenset({"reason", "message", "stop_reason"})
"""Fields that hold sentences: another version may word the same decision differently."""

_quick_json = msgspec.json.Encoder().encode
"""Same as `to_json` except for floats with an exponent, nan, inf, and text beyond ASCII."""

DECISION_NAMES = frozenset(kind.__name__ for kind in get_args(Decision))
"""The names in the journal of the effects that are compared with those of another version."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """The rules of comparison for a recording; a `version` of "" is unknown."""

    version: str = __version__
    made_by: str = MADE_BY

    @property
    def same_version(self) -> bool:
        """Whether this version made the recording."""
        return self.version == __version__

    @property
    def same_platform(self) -> bool:
        """Whether the same libc and Python computed the floats."""
        return self.made_by == MADE_BY

    @property
    def is_exact(self) -> bool:
        """Whether everything is compared bit for bit."""
        return self.same_version and self.same_platform

    def notes(self) -> Iterator[str]:
        """Say what is not compared exactly and why, one sentence each."""
        if not self.same_version:
            yield (
                f"made by robotctl {self.version or '(unknown version)'}, this is {__version__}: "
                f"compared are commands, modes, the latch and answers, without their wording"
            )
        if not self.same_platform:
            yield (
                f"made with {self.made_by or 'an unknown Python'}, this is {MADE_BY}: "
                f"floats are compared to {TOLERANCE:g}"
            )

    def same(self, recorded: str, value: object) -> bool:
        """Return whether the text of the journal means `value`."""
        if recorded.encode() == _quick_json(value):
            return True
        mine = to_json(value)
        if recorded == mine:
            return True
        return not self.is_exact and not self.differences(recorded, mine)

    def differences(self, recorded: str, decided: str) -> list[str]:
        """Return the differences of two JSON texts, as `path: recorded ..., decided ...`."""
        try:
            theirs = json.loads(recorded)
        except (ValueError, RecursionError):
            return ["the recorded text is not JSON"]
        return [
            f"{path}: recorded {json.dumps(theirs)}, decided {json.dumps(mine)}"
            for path, theirs, mine in self._differing("", theirs, json.loads(decided))
        ]

    def _differing(self, path: str, theirs: Any, mine: Any) -> Iterator[tuple[str, Any, Any]]:
        if isinstance(theirs, dict) and isinstance(mine, dict):
            for name in self._comparable(theirs, mine):
                where = f"{path}.{name}" if path else name
                yield from self._differing(where, theirs.get(name), mine.get(name))
        elif isinstance(theirs, list) and isinstance(mine, list) and len(theirs) == len(mine):
            for position, (each, own) in enumerate(zip(theirs, mine, strict=True)):
                yield from self._differing(f"{path}[{position}]", each, own)
        elif not self._same_leaf(theirs, mine):
            yield path, theirs, mine

    def _comparable(self, theirs: dict[str, Any], mine: dict[str, Any]) -> list[str]:
        if self.same_version:
            return [*mine, *(name for name in theirs if name not in mine)]
        return [name for name in mine if name in theirs and name not in WORDING]

    def _same_leaf(self, theirs: Any, mine: Any) -> bool:
        if isinstance(theirs, float) and isinstance(mine, float) and not self.same_platform:
            return abs(theirs - mine) <= TOLERANCE * max(1.0, abs(theirs), abs(mine))
        return repr(theirs) == repr(mine)
