"""Checks how a recording begins and ends: the first entries, the last snapshot, the ledger."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from robotctl.kernel.snapshot import Proof, Snapshot
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.format.ledger_record import read_ledger
from robotctl.recording.format.metadata_names import CLIP_RECORD, INFO_RECORD
from robotctl.recording.format.natural_order import natural_order
from robotctl.rerun.check_report import Report
from robotctl.rerun.ending import Ending
from robotctl.rerun.invariants import Invariants, unbalanced
from robotctl.rerun.journal_origin import JournalOrigin
from robotctl.rerun.journal_values import read_snapshot
from robotctl.rerun.recorded_parameters import differing_parameters
from robotctl.rerun.schema_check import check_schemas


class RecordingEnds:
    """The numbers of the first and the last journal entry, and the ledger of the last file."""

    def __init__(
        self, recording: Recording, info: RecordingInfo, report: Report, origin: JournalOrigin
    ) -> None:
        self.origin = origin
        self._recording = recording
        self._info = info
        self._report = report
        self._first_seq = self._last_seq = -1
        self._last_snapshot = -1
        self._ledger: Mapping[str, Mapping[str, int]] | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it is a folder, and the last file is there."""
        last = natural_order(self._recording.open_files[-1].path)
        lost = (Path(name) for name in self._recording.lost_files)
        return self._recording.path.is_dir() and not any(
            natural_order(each) > last for each in lost
        )

    def entries(self, first: int, last: int) -> None:
        """Take the numbers of the next entries, which are in a row."""
        if self._first_seq < 0:
            self._first_seq = first
        self._last_seq = max(last, self._last_seq)

    def begin(self, entry: JournalEntry) -> None:
        """Compare the first snapshot with what a kernel begins with."""
        report = self._report
        if entry.seq or not report.same_version or not self.origin.is_own:
            return
        snapshot = read_snapshot(entry)
        if not _is_beginning(snapshot):
            report.miss("its journal begins later than its kernel: the first are missing")
        noted = self._recording.metadata_of_file(0).get(INFO_RECORD, {})
        for sentence in differing_parameters(noted, snapshot.params):
            report.miss(sentence, is_beside=True)

    def snapshot(self, entry: JournalEntry, proof: Proof | None) -> int:
        """Take a snapshot; return the number of the one before it, 0 if there is none."""
        before = max(self._last_snapshot, 0)
        self._last_snapshot = entry.seq if proof is not None else -1
        return before

    def check(self, events_before_snapshot: int) -> None:
        """Check who wrote the journal, and that a whole one begins and ends with a snapshot."""
        report, origin = self._report, self.origin
        origin.check(report)
        if not (origin.is_own and self.is_whole) or self._last_snapshot < 0:
            return
        if self._first_seq and self._info.files[0].name == f"{self._recording.path.name}_0.mcap":
            report.miss(f"its journal begins with entry {self._first_seq}: the first are missing")
        elif events_before_snapshot and not self._first_seq:
            report.miss("its journal does not begin with a snapshot")
        was_closed = not (self._recording.is_cut_off or self._recording.is_live)
        if was_closed and self._last_snapshot != self._last_seq:
            report.miss("it was closed, but its journal does not end with a snapshot")

    def read_ledger(self, invariants: Invariants) -> None:
        """Check the loss ledger in the last file; there is none if it was not closed."""
        check_schemas(self._recording, self._report, invariants)
        ledger = read_ledger(self._recording.metadata_of_file(-1))
        if not ledger and CLIP_RECORD in self._info.metadata:
            return  # a clip has no ledger: its source has it
        if not ledger:
            self._report.notes.append("it was not closed: it has no loss ledger to check")
            return
        for sentence in unbalanced(ledger, finished=self.is_whole):
            invariants.violate(sentence)
        self._ledger = ledger

    def ending(self, topic: str | None) -> Ending:
        """Return how the recording ends for a topic."""
        return Ending(
            None if self._ledger is None else self._ledger.get(topic or "", {}),
            is_clip=CLIP_RECORD in self._info.metadata,
            is_own=self.origin.is_own,
            is_whole=self.is_whole,
            has_begin=self._first_seq == 0,
        )


def _is_beginning(snapshot: Snapshot) -> bool:
    """Return whether a kernel has done nothing before this snapshot."""
    state, proof = snapshot.state, snapshot.proof
    has_heard = state.health.odometry is not None or state.health.battery_level is not None
    has_run = state.tick_t_ns is not None or state.drive is not None or has_heard
    return not has_run and (proof is None or proof == Proof(commands=0, journal_crc=0))
