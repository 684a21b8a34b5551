"""Entries that a journal of decisions must hold and does not, as the recordings show.

The journal's own times prove nothing: who rewrites it writes them too. The recordings, which are
sealed, tell which entry was the newest one at which time, and for how long entries are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from math import inf

from robotctl.decisions.journal import YEAR_S, DecisionKind, LogContent
from robotctl.evidence.recordings import FileOfJournal
from robotctl.kernel.units import NS_PER_S


@dataclass(slots=True)
class MissingEntries:
    """`broken` says which file shows that entries were removed; `gaps`, that old ones are missing
    too early.
    """

    broken: list[str] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)


def missing_entries(log: LogContent, files: Sequence[FileOfJournal], now_ns: int) -> MissingEntries:
    """Compare a journal with the files of the recordings. `now_ns` is the wall clock."""
    found = MissingEntries()
    years = _keep_years(log, files)
    oldest_ns = now_ns - years * YEAR_S * NS_PER_S
    for file in files:
        may_be_removed = log.begins_later and file.start_ns < oldest_ns
        if file.head and file.head not in log.heads and not may_be_removed:
            found.broken.append(
                f"{file.name} knows an entry that is not there: the journal was cut off, or it was "
                "rewritten"
            )
    if log.begins_later and log.entries and log.entries[0].time_ns > oldest_ns:
        kept = "forever" if years == inf else f"for {years:g} years"
        found.gaps.append(
            f"entries are kept {kept}, and the first ones are missing: they were removed too "
            "early, or the robot was off before those that are left"
        )
    return found


def _keep_years(log: LogContent, files: Sequence[FileOfJournal]) -> float:
    """Return the shortest time that a recording names; without one, what the journal says."""
    recorded = [file.keep_years for file in files if file.keep_years is not None]
    if not recorded:
        for entry in log.entries:
            if entry.kind == DecisionKind.CONFIGURATION:
                with suppress(ValueError, TypeError, KeyError):
                    recorded.append(float(entry.values["decisions.keep_years"]))
    return min((years for years in recorded if years > 0.0), default=inf)
