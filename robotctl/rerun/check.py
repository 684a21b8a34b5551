"""Checks a recording: does a new kernel decide the same, and do the invariants hold?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from robotctl.errors import UnreadableFile
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording, RecordingInfo, read_info
from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.format.ledger_record import read_ledger
from robotctl.recording.format.metadata_names import CLIP_RECORD, INFO_RECORD, OWN_LIBRARY
from robotctl.recording.read.journal_reader import EntryDecoder, journal_topic
from robotctl.rerun.check_report import Report
from robotctl.rerun.comparison import Comparison
from robotctl.rerun.invariants import Invariants, unbalanced
from robotctl.rerun.journal_steps import Gap, Step, steps
from robotctl.rerun.journal_values import read_effect, read_snapshot
from robotctl.rerun.rerun import Divergence, Rerun
from robotctl.rerun.traffic import CommandTraffic, command_topic
from robotctl.rerun.vocabulary import Vocabulary

Progress = Callable[[int, int], None]
"""Called with the bytes that are done and the bytes in total."""


def check_recording(path: Path, on_progress: Progress = lambda done, total: None) -> Report:
    """Check one recording, a file or a folder, and return the report.

    A file that cannot be read is named in the report.
    """
    report = Report(path)
    began = time.perf_counter()
    try:
        with Recording(path) as recording:
            _Check(recording, report, on_progress).run()
    except UnreadableFile as error:
        report.miss(str(error))
    report.took_s = time.perf_counter() - began
    return report


class _Check:
    """One pass over the messages of a recording, in the order of writing."""

    def __init__(self, recording: Recording, report: Report, on_progress: Progress) -> None:
        self._recording = recording
        self._report = report
        self._on_progress = on_progress
        self._info = recording.info()
        self._invariants = Invariants()
        self._traffic = CommandTraffic()
        self._vocabulary: Vocabulary | None = Vocabulary()
        self._rerun: Rerun | None = None
        self._before_snapshot = 0
        self._end_ns = 0

    def run(self) -> None:
        """Fill the report.

        Raises:
            UnreadableFile: The recording has no journal, or cannot be read at all.
        """
        report, info = self._report, self._info
        for sentence in self._recording.missing:
            report.miss(sentence)
        report.robot = info.metadata.get(INFO_RECORD, {}).get("robot", "")
        report.version = _version(info)
        topic = journal_topic(info)
        if topic is None:
            raise UnreadableFile("it holds no journal of robotctl: there are no decisions to check")
        for item in steps(self._entries(topic)):
            if isinstance(item, Gap):
                report.miss(item.text)
                self._stop()
            elif isinstance(item, Step):
                self._step(item)
            else:
                self._snapshot(item)
        self._end()

    def _entries(self, topic: str) -> Iterator[JournalEntry]:
        """Yield the journal entries; hand the recorded commands to the traffic check."""
        report = self._report
        commands = command_topic(self._info, topic)
        messages = self._recording.in_order_written(
            {topic} if commands is None else {topic, commands}, report.miss, self._on_progress
        )
        decoder = EntryDecoder(self._recording)
        for message in messages:
            if message.topic == topic:
                entry = decoder.decode(message.data)
                if not report.begin_log_ns:
                    report.begin_ns, report.begin_log_ns = entry.t_ns, message.log_ns
                self._end_ns = entry.t_ns
                yield entry
            elif self._traffic.seen or message.publish_ns >= report.begin_log_ns > 0:
                self._traffic.message(message.data)  # else decided in an earlier file

    def _snapshot(self, entry: JournalEntry) -> None:
        report = self._report
        try:
            self._compare_vocabulary(entry)
            if self._rerun is None:
                report.made_by = read_snapshot(entry).made_by
                comparison = Comparison(report.version, report.made_by)
                report.bitwise = comparison.is_exact
                report.notes += comparison.notes()
                self._rerun = Rerun(comparison)
            snapshot, divergence = self._rerun.snapshot(entry)
        except UnreadableFile as error:
            self._interrupt_at(error)
            return
        self._note(divergence)
        self._invariants.snapshot(snapshot)

    def _step(self, step: Step) -> None:
        report = self._report
        report.events += 1
        report.effects += len(step.effects)
        try:
            if self._rerun is None:
                self._before_snapshot += 1
                self._traffic.step(tuple(map(read_effect, step.effects)))
                return
            self._compare_vocabulary(step.event, *step.effects)
            decided = self._rerun.step(step)
            effects = decided.effects
            if effects is None:
                self._note(decided.divergence)
                effects = tuple(map(read_effect, step.effects))
        except UnreadableFile as error:
            self._interrupt_at(error)
            return
        if effects:
            self._traffic.step(effects)
        self._invariants.step(step.event.seq, decided.event, effects)

    def _note(self, divergence: Divergence | None) -> None:
        report = self._report
        if divergence is None or report.divergence is not None:
            return
        report.divergence = divergence
        if not report.same_version:
            report.miss_other_rules(divergence.sentence())

    def _compare_vocabulary(self, *entries: JournalEntry) -> None:
        """Report the first field of another version that this version does not know."""
        if self._vocabulary is None or self._report.same_version:
            return
        for entry in entries:
            if field := self._vocabulary.unknown_field(entry):
                self._report.miss_other_rules(f"entry {entry.seq}: {field!r} is not known")
                self._vocabulary = None
                return

    def _interrupt_at(self, error: UnreadableFile) -> None:
        """Report an entry that this version cannot read, and pause until the next snapshot."""
        report = self._report
        (report.miss if report.same_version else report.miss_other_rules)(str(error))
        self._stop()

    def _stop(self) -> None:
        """Pause re-run and invariants until the next snapshot."""
        self._invariants.stop()
        if self._rerun is not None:
            self._rerun.stop()

    def _end(self) -> None:
        report, invariants = self._report, self._invariants
        report.duration_s = (self._end_ns - report.begin_ns) / NS_PER_S
        if self._rerun is None:
            report.miss("its journal holds no snapshot of the kernel to begin from")
            return
        if self._before_snapshot:
            report.notes.append(f"{self._before_snapshot} events before the first snapshot")
        kernel = self._rerun.kernel
        if kernel is not None:
            invariants.end(kernel.state.waiting)
        self._check_traffic()
        self._check_ledger()
        report.violations, report.violation_count = invariants.violations, invariants.count

    def _check_traffic(self) -> None:
        report, commands = self._report, self._traffic
        commands.end()
        report.commands = commands.seen
        if not commands.undecided:
            return
        text = f"{commands.undecided} commands without a decision, such as {commands.example}"
        if self._invariants.foreign:
            names = ", ".join(sorted(self._invariants.foreign))
            report.notes.append(f"{text}: {names} published as well")
        elif report.missing or report.divergence is not None:
            report.notes.append(text)
        else:
            self._invariants.violate(text)

    def _check_ledger(self) -> None:
        """Check the loss ledger in the last file of a recording that was closed."""
        path = self._recording.path
        ledger = read_ledger(read_info(self._info.files[-1]).metadata)
        if not ledger and CLIP_RECORD in self._info.metadata:
            return  # a clip has no ledger: its source has it
        if not ledger:
            self._report.notes.append("it was not closed: it has no loss ledger to check")
            return
        for sentence in unbalanced(ledger, finished=path.is_dir()):
            self._invariants.violate(sentence)


def _version(info: RecordingInfo) -> str:
    """Return the version of robotctl that made the recording, "" if it is not recorded."""
    known = info.metadata.get(INFO_RECORD, {}).get("robotctl", "")
    if known or not info.library.startswith(OWN_LIBRARY):
        return known
    return info.library.removeprefix(OWN_LIBRARY)
