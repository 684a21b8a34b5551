"""Checks the velocity commands of a recording against its decisions, and says what differs."""

from __future__ import annotations

from robotctl.kernel.codec import Snapshot
from robotctl.kernel.types import Effect, Event
from robotctl.recording.read.messages import Message
from robotctl.rerun.check_report import Report
from robotctl.rerun.clock_changes import ClockChanges
from robotctl.rerun.command_pairs import CommandPairs
from robotctl.rerun.invariants import Invariants
from robotctl.rerun.journal_steps import Moments
from robotctl.rerun.recording_ends import Ending

CUT = 3
"""This many of the last commands in a clip may have been decided after the end of its journal."""


class CommandCheck:
    """Compares commands with decisions by number; in a recording of 0.1.0, only counts commands."""

    def __init__(self, report: Report, clock: ClockChanges) -> None:
        self._report = report
        self._clock = clock
        self._pairs = CommandPairs()
        self._by_number: bool | None = None
        self._seen = 0

    def message(self, message: Message) -> None:
        """Read a message of the command topic."""
        self._seen += 1
        if self._by_number:
            self._pairs.message(message.sequence, message.data, message.publish_ns)

    def snapshot(self, snapshot: Snapshot) -> None:
        """Continue from a snapshot."""
        if self._by_number is None:
            self._by_number = snapshot.proof is not None
        if snapshot.proof is not None:
            self._pairs.resume(snapshot.proof)

    def stop(self) -> None:
        """Pause until the next snapshot: events are missing."""
        self._pairs.stop()

    def step(self, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Compare the commands of a step; `moments` is when it began and ended."""
        if self._by_number:
            self._clock.look(event.t_ns, moments[1])
            self._pairs.step(event, effects, moments)

    def end(self, invariants: Invariants, ending: Ending) -> None:
        """Report the differences between commands and decisions."""
        self._report.commands = self._seen
        if not self._by_number:
            return
        pairs = self._pairs
        is_closed = ending.ledger is not None
        cut = CUT if ending.is_clip else 0
        old, recent = pairs.end(cut, is_own=ending.is_own, is_closed=is_closed)
        others = pairs.others
        self._tell_foreign(invariants, others.foreign, others.foreign_example)
        self._tell_extra(invariants, ending, others.extra, others.extra_example)
        self._tell_missing(invariants, ending)
        self._tell_end(invariants, ending, old, recent)
        self._tell_undecided(ending)
        if ending.is_own:
            self._tell_late(invariants, ending)
        if pairs.counts.unsent:
            self._report.notes.append("the journal tells of commands that could not be sent")
        elif pairs.counts.resumed:
            self._report.miss("a snapshot counts other commands than were decided before it")
        if pairs.counts.out_of_order:
            self._report.miss(
                f"{pairs.counts.out_of_order} commands are not in the order of their number"
            )

    def _tell_foreign(self, invariants: Invariants, count: int, example: str) -> None:
        if count:
            names = ", ".join(sorted(invariants.foreign))
            text = f"{_without_decision(count, example)}: {names} published as well"
            self._report.notes.append(text)

    def _tell_extra(self, invariants: Invariants, ending: Ending, count: int, example: str) -> None:
        if count:
            ending.accuse(self._report, invariants, _without_decision(count, example))

    def _tell_missing(self, invariants: Invariants, ending: Ending) -> None:
        pairs = self._pairs
        count = pairs.counts.missing + (0 if ending.is_clip else pairs.counts.before_first)
        if not count:
            return
        text = f"{count} decided commands are missing"
        if pairs.counts.missing_example:
            text += f", the first is {pairs.counts.missing_example}"
        if count <= ending.lost:
            self._report.notes.append(f"{text}: {ending.lost} were counted as lost")
        elif ending.ledger is None:
            self._report.miss(f"{text}; {ending.unknown_losses}")
        else:
            ending.accuse(self._report, invariants, text)

    def _tell_end(self, invariants: Invariants, ending: Ending, old: int, recent: int) -> None:
        is_closed = ending.is_whole and ending.ledger is not None and not invariants.foreign
        count = old + (recent if is_closed else 0)
        if count <= ending.lost:
            return
        if not self._pairs.counts.paired and is_closed and old:
            ending.accuse(self._report, invariants, f"none of {count} decided commands is recorded")
        else:
            self._report.miss(f"the last {count} decided commands are missing")

    def _tell_undecided(self, ending: Ending) -> None:
        notes, undecided = self._report.notes, self._pairs.counts.undecided
        if not ending.is_own:
            if after := undecided + self._pairs.others.after_end:
                notes.append(f"{after} commands are later than the journal that was received")
        elif undecided and not ending.is_clip:
            notes.append(
                f"the last {undecided} zeros have no decision: the recording ends before its "
                "journal tells of a stall or a failure"
            )

    def _tell_late(self, invariants: Invariants, ending: Ending) -> None:
        late = [
            text
            for steady_ns, text in self._pairs.counts.late
            if not self._clock.is_near(steady_ns)
        ]
        if late:
            ending.accuse(
                self._report,
                invariants,
                f"{len(late)} commands were not sent when decided: {late[0]}",
            )


def _without_decision(count: int, example: str) -> str:
    return f"{count} commands without a decision, such as {example}"
