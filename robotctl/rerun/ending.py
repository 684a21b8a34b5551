"""How a recording ends, which decides what may be missing in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from robotctl.rerun.check_report import Report
from robotctl.rerun.invariants import Invariants

IN_SOURCE = "a clip does not tell what was lost, its source does"
"""Why a clip may lack something."""


@dataclass(frozen=True, slots=True)
class Ending:
    """The end of a recording, for one of its topics.

    `ledger` holds the counts of the topic, None if the recording was not closed.
    """

    ledger: Mapping[str, int] | None
    is_clip: bool
    is_own: bool
    """Whether the recorder wrote the journal itself: one that it received may come late."""

    is_whole: bool
    """Whether the last file is there, in a folder: no message is in a file after it."""

    has_begin: bool
    """Whether the journal is there from its first entry on."""

    @property
    def lost(self) -> int:
        """The number of messages that were counted as not recorded."""
        ledger = self.ledger or {}
        return sum(ledger.get(count, 0) for count in ("lost", "unseen", "dropped"))

    @property
    def unknown_losses(self) -> str:
        """Why the losses are not known, where there is no ledger."""
        return IN_SOURCE if self.is_clip else "it was not closed, so its losses are not known"

    def accuse(self, report: Report, invariants: Invariants, text: str) -> None:
        """Report a broken promise; only a note where what is missing may explain it."""
        if report.has_gaps or report.divergence is not None:
            report.notes.append(text)
        else:
            invariants.violate(text)


class JournalEnd(NamedTuple):
    """When the journal ends, on the steady clock and since the epoch, after stalls shortly before.

    `clock_changed` tells whether the two clocks ever moved against each other.
    """

    t_ns: int
    log_ns: int
    stalled_ns: int
    clock_changed: bool
