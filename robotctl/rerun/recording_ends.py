"""Checks how a recording begins and ends: the first entries, the last snapshot, the ledger."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from robotctl.kernel.snapshot import Proof, Snapshot
from robotctl.kernel.types import Cause
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

SINGLE_FILE: Final = "the journal goes on after this file, or was cut off: check the whole folder"


class RecordingEnds:
    """The numbers of the first and the last journal entry, and the ledger of the last file."""

    def __init__(
        self, recording: Recording, info: RecordingInfo, report: Report, origin: JournalOrigin
    ) -> None:
        self.origin = origin
        self._recording = recording
        self._info = info
        self._report = report
        self._is_clip = CLIP_RECORD in info.metadata
        self._first_seq = self._last_seq = -1
        self._last_snapshot = -1
        self._has_ended = False
        """Whether the last snapshot is of a daemon that was ending."""

        self._ledger: Mapping[str, Mapping[str, int]] | None = None
        last = natural_order(recording.open_files[-1].path)
        self._goes_on = any(natural_order(Path(name)) > last for name in recording.lost_files)
        """Whether a later file is not here, or the end is cut off."""

    @property
    def is_whole(self) -> bool:
        """Whether it is a folder, and the last file is there."""
        return self._recording.path.is_dir() and not self._goes_on

    def entry(self, seq: int) -> None:
        """Note the number of the next entry."""
        if self._first_seq < 0:
            self._first_seq = seq
        self._last_seq = max(seq, self._last_seq)

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

    def snapshot(self, entry: JournalEntry, snapshot: Snapshot) -> int:
        """Take a snapshot; return the number of the one before it, 0 if there is none."""
        before = max(self._last_snapshot, 0)
        self._last_snapshot = entry.seq if snapshot.proof is not None else -1
        reported = snapshot.state.health.reported
        self._has_ended = any(cause is Cause.DAEMON_ENDS for cause, _ in reported)
        return before

    def check(self, events_before_snapshot: int, invariants: Invariants) -> None:
        """Check who wrote the journal, how it begins and ends, and the ledger of the last file.

        There is no ledger if the recording was not closed.
        """
        ledger = read_ledger(self._recording.metadata_of_file(-1))
        self.origin.check(self._report)
        if self.origin.is_own and self._last_snapshot >= 0:
            if self._recording.path.is_dir():
                self._check_begin(events_before_snapshot)
            self._check_end(ledger)
        check_schemas(self._recording, self._report)
        self._check_ledger(ledger, invariants)

    def _check_begin(self, events_before_snapshot: int) -> None:
        report = self._report
        if self._first_seq and self._info.files[0].name == f"{self._recording.path.name}_0.mcap":
            report.miss(f"its journal begins with entry {self._first_seq}: the first are missing")
        elif events_before_snapshot and not self._first_seq:
            report.miss("its journal does not begin with a snapshot")

    def _check_end(self, ledger: Mapping[str, Mapping[str, int]]) -> None:
        """Look whether the last file is the one with which the recording was closed."""
        recording = self._recording
        if recording.is_cut_off or recording.is_live or self._goes_on:
            return
        is_queued = any(counts.get("queued") for counts in ledger.values())
        has_ended = self._has_ended or not self._report.same_version
        if not is_queued and has_ended and self._last_snapshot == self._last_seq:
            return
        self._goes_on = True
        if not recording.path.is_dir():
            if not self._is_clip:
                self._report.notes.append(SINGLE_FILE)
            return
        why = "messages were still to be written" if is_queued else "its journal ends before"
        self._report.miss(
            f"the file with which it was closed is not here, or not whole: {why}", is_beside=True
        )

    def _check_ledger(
        self, ledger: Mapping[str, Mapping[str, int]], invariants: Invariants
    ) -> None:
        if ledger:
            for sentence in unbalanced(ledger, finished=self.is_whole):
                invariants.violate(sentence)
            self._ledger = ledger
        elif not self._is_clip:  # the source of a clip has it
            self._report.notes.append("it was not closed: it has no loss ledger to check")

    def ending(self, topic: str | None) -> Ending:
        """Return how the recording ends for a topic."""
        return Ending(
            None if self._ledger is None else self._ledger.get(topic or "", {}),
            is_clip=self._is_clip,
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
