"""Checks a recording: does a new kernel decide the same, and do the invariants hold?"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.kernel.types import Effect, Event
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.format.metadata_names import INFO_RECORD, OWN_LIBRARY
from robotctl.recording.read.journal_reader import journal_topic, journal_topics
from robotctl.recording.read.source import Source
from robotctl.rerun.bytes_check import check_bytes
from robotctl.rerun.check_reading import CheckReading
from robotctl.rerun.check_report import Report
from robotctl.rerun.comparison import Comparison
from robotctl.rerun.comparisons import Comparisons
from robotctl.rerun.divergence import Divergence
from robotctl.rerun.entry_order import Gap
from robotctl.rerun.journal_format import JournalFormat
from robotctl.rerun.journal_origin import JournalOrigin
from robotctl.rerun.journal_steps import Step
from robotctl.rerun.journal_values import read_effect, read_event, read_snapshot
from robotctl.rerun.recording_ends import RecordingEnds
from robotctl.rerun.recording_groups import FileGroup, file_groups
from robotctl.rerun.rerun import Rerun
from robotctl.rerun.snapshot_proofs import SnapshotProofs
from robotctl.rerun.unknown_fields import without_retired_fields
from robotctl.store.remote_file import RemoteFile

Progress = Callable[[int, int], None]
"""Called with the bytes that are done and the bytes in total."""


def check_recording(
    path: Path,
    on_progress: Progress = lambda done, total: None,
    *,
    all_bytes: bool = False,
    source: Source | None = None,
) -> Report:
    """Check one recording, a file or a folder, and return the report.

    A file that cannot be read is named in the report. Every byte is read if `all_bytes` is set, or
    if the recording is small. With `source`, one MCAP file is read from there, no more of it than
    the check needs, and `path` is only its name.
    """
    report = Report(path)
    began = time.perf_counter()
    others: list[FileGroup] = []
    try:
        files: list[Path] = []
        if source is None:
            (_, files), *others = file_groups(path)
        with Recording(path, source=source, files=files if others else ()) as recording:
            _Check(recording, report, on_progress).run()
    except UnreadableFile as error:
        report.miss(str(error))
    for group in others:
        for file in group.files:
            other = check_recording(file)
            report.miss(
                f"{file.name} is of another recording, of robot {other.robot or '(unknown)'}: "
                f"checked on its own, it is {other.verdict}"
            )
    if source is None and not (isinstance(path, RemoteFile) and not all_bytes):
        check_bytes(path, report, all_bytes=all_bytes)
    else:
        how = ": --all-bytes reads them all" if source is None else ", only what the check needs"
        report.notes.append(f"not every byte was read{how}")
    report.took_s = time.perf_counter() - began
    return report


class _Check:
    """One pass over the messages of a recording, in the order of writing."""

    def __init__(self, recording: Recording, report: Report, on_progress: Progress) -> None:
        self._recording = recording
        self._report = report
        self._on_progress = on_progress
        self._info = recording.info()
        self._format = JournalFormat(report)
        self._rerun: Rerun | None = None
        self._before_snapshot = 0
        report.robot = self._info.metadata.get(INFO_RECORD, {}).get("robot", "")
        report.version = _version(self._info)
        self._log_ns = (0, 0)
        """When the last two events before the present item were recorded, since the epoch [ns]."""

    def run(self) -> None:
        """Fill the report.

        Raises:
            UnreadableFile: The recording has no journal, or cannot be read at all.
        """
        report, info = self._report, self._info
        for sentence in self._recording.missing:
            report.miss(sentence, is_beside=not self._recording.lacks_parts)
        topic = journal_topic(info)
        if topic is None:
            raise UnreadableFile("it holds no journal of robotctl: there are no decisions to check")
        for other in sorted(journal_topics(info) - {topic}):
            report.notes.append(f"the journal {other} of another robot was not checked")
        self._ends = RecordingEnds(self._recording, info, report, JournalOrigin(info, topic))
        self._compared = Comparisons(report, info, topic)
        self._reading = CheckReading(self._recording, report, self._ends, self._on_progress)
        self._proofs = SnapshotProofs(report, self._reading.chain, self._compared.invariants)
        for item, log_ns in self._reading.items(topic, self._compared.readers()):
            self._log_ns = log_ns
            if isinstance(item, Step):
                self._step(item)
            elif isinstance(item, Gap):
                report.miss(item.text)
                self._stop()
            else:
                self._snapshot(item)
        self._end()

    def _snapshot(self, entry: JournalEntry) -> None:
        report, known = self._report, without_retired_fields(entry)
        try:
            if self._rerun is None:
                self._format.begin(known)
            self._format.compare(known)
            if self._rerun is None:
                report.made_by = read_snapshot(entry).made_by
                version = report.version if report.same_version else report.other_version
                comparison = Comparison(version, report.made_by)
                report.bitwise = comparison.is_exact
                report.notes += comparison.notes()
                self._rerun = Rerun(comparison)
                self._ends.begin(entry)
            snapshot, divergence = self._rerun.snapshot(known)
        except UnreadableFile as error:
            self._interrupt_at(error)
            return
        self._note(divergence)
        self._proofs.take(entry, snapshot.proof, self._ends.snapshot(entry, snapshot))
        self._compared.snapshot(snapshot, entry.t_ns, self._log_ns[1])

    def _step(self, step: Step) -> None:
        entry, report, rerun = step.event, self._report, self._rerun
        report.events += 1
        report.effects += len(step.effects)
        try:
            if rerun is None:
                self._before_snapshot += 1
                if step.effects:
                    self._compared.step_before_snapshot(
                        read_event(entry), tuple(map(read_effect, step.effects))
                    )
                return
            event, effects = self._decided(rerun, step)
        except UnreadableFile as error:
            self._interrupt_at(error)
            return
        self._compared.step(entry.seq, event, effects, (event.t_ns, *self._log_ns))

    def _decided(self, rerun: Rerun, step: Step) -> tuple[Event, tuple[Effect, ...]]:
        """Decide on one step; return its event and effects.

        Raises:
            UnreadableFile: An entry cannot be read.
        """
        self._format.compare(step.event, *step.effects)
        event, effects, divergence = rerun.step(step)
        if effects is None:
            self._note(divergence)
            effects = tuple(map(read_effect, step.effects))
        return event, effects

    def _note(self, divergence: Divergence | None) -> None:
        report = self._report
        if divergence is None:
            return
        report.count_divergence(divergence)
        if report.divergence is not None:
            return
        report.divergence = divergence
        if not report.same_version:
            report.miss_other_rules(divergence.sentence())

    def _interrupt_at(self, error: UnreadableFile) -> None:
        """Report an entry that this version cannot read, and pause until the next snapshot."""
        report = self._report
        (report.miss if report.same_version else report.miss_other_rules)(str(error))
        self._stop()

    def _stop(self) -> None:
        """Pause re-run and comparisons until the next snapshot."""
        self._compared.stop()
        if self._rerun is not None:
            self._rerun.stop()

    def _end(self) -> None:
        report, ends, invariants = self._report, self._ends, self._compared.invariants
        report.duration_s = (self._reading.end_ns - report.begin_ns) / NS_PER_S
        if self._rerun is None:
            report.miss("its journal holds no snapshot of the kernel to begin from")
            return
        if self._before_snapshot:
            report.notes.append(f"{self._before_snapshot} events before the first snapshot")
        ends.check(self._before_snapshot, invariants)
        kernel = self._rerun.kernel
        if kernel is not None:
            invariants.end(kernel.state.waiting)
        self._compared.end(ends.ending, self._reading.end_ns, self._log_ns[1])
        report.violations, report.violation_count = invariants.violations, invariants.count


def _version(info: RecordingInfo) -> str:
    """Return the version of robotctl that made the recording, "" if it is not recorded."""
    known = info.metadata.get(INFO_RECORD, {}).get("robotctl", "")
    if known or not info.library.startswith(OWN_LIBRARY):
        return known
    return info.library.removeprefix(OWN_LIBRARY)
