"""Checks a recording: does a new kernel decide the same, and do the invariants hold?"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final, NamedTuple

from robotctl.base.errors import UnreadableFile
from robotctl.base.store.remote_file import RemoteFile
from robotctl.kernel.types import Effect, Event
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.recording.format.names import INFO_RECORD, OWN_LIBRARY
from robotctl.recording.read.files import recording_files
from robotctl.recording.read.journal_reader import EntryDecoder, journal_topic, journal_topics
from robotctl.recording.read.messages import Message
from robotctl.recording.read.seal_check import SealState
from robotctl.recording.read.source import Source
from robotctl.recording.read.whole_recording import VerifiedRecording, verify_recording
from robotctl.rerun.check_report import Divergence, Report
from robotctl.rerun.comparisons import Comparisons
from robotctl.rerun.journal_format import JournalFormat, without_retired_fields
from robotctl.rerun.journal_steps import EntryOrder, Gap, Item, LogTimes, Step
from robotctl.rerun.journal_values import read_effect, read_event, read_snapshot
from robotctl.rerun.recording_ends import JournalOrigin, RecordingEnds
from robotctl.rerun.rerun import Comparison, Rerun
from robotctl.rerun.snapshot_proofs import JournalChain, SnapshotProofs

ALL_BYTES_BELOW: Final = 100_000_000
"""A recording smaller than this [bytes] is always read completely, which takes about 1 s."""

_KEY_DIGITS = 16


def is_small(path: Path) -> bool:
    """Return whether a recording is so small that a check always reads every byte of it.

    Raises:
        OSError, UnreadableFile: There is no recording.
    """
    return sum(file.stat().st_size for file in recording_files(path)) < ALL_BYTES_BELOW


def check_bytes(path: Path, report: Report, *, all_bytes: bool) -> None:
    """Read every byte of the recording `path`, if it is small or `all_bytes` is set.

    Flaws are added to `report.missing`: what was recorded there is unknown. The report also gets
    a line about the seal, which does not change the verdict.
    """
    try:
        if not all_bytes and not is_small(path):
            report.notes.append("not every byte was read: --all-bytes reads them all")
            return
        found = verify_recording(path)
    except (OSError, UnreadableFile):
        return  # the check has told why
    for sentence in (*found.whole.unreadable, *found.whole.wrong):
        if sentence not in report.missing:
            report.miss(sentence)
    report.seal = _seal_line(found)


def _seal_line(found: VerifiedRecording) -> str:
    """Return one line about what the seals prove, or "" if there is no seal."""
    states = [file.seal.state for file in found.files]
    if set(states) <= {SealState.NONE}:
        return ""
    broken = next((sentence for file in found.files for sentence in file.seal.wrong), "")
    if broken or found.chain.wrong:
        return f"broken: {broken or found.chain.wrong[0]}"
    sealed = states.count(SealState.SEALED)
    opening = next(file.seal.opening for file in found.files if file.seal.opening is not None)
    extent = "whole" if sealed == len(states) else f"{sealed} of {len(states)} files whole"
    return f"{extent}, unbroken, by {opening.robot}'s key {opening.root[:_KEY_DIGITS]}"


class FileGroup(NamedTuple):
    """The files of one recording in order, and the name of its robot ("" if not recorded)."""

    robot: str
    files: list[Path]


def file_groups(path: Path) -> list[FileGroup]:
    """Return the files of `path` grouped by recording; the group named like `path` comes first.

    A file joins a group of the same robot if it has no journal, or if its first journal entry has a
    higher `seq` than the first entries of the group's files. Unreadable files join the first group,
    whose check reports why they cannot be read.

    Raises:
        UnreadableFile: `path` is not a recording.
    """
    files = recording_files(path)
    if len(files) < 2:
        return [FileGroup("", files)]
    groups: list[FileGroup] = []
    newest: list[int] = []
    loose: list[Path] = []
    for file in files:
        try:
            robot, first = _identity(file)
        except UnreadableFile:
            loose.append(file)
            continue
        for number, group in enumerate(groups):
            if group.robot == robot and (first is None or first > newest[number]):
                group.files.append(file)
                newest[number] = newest[number] if first is None else first
                break
        else:
            groups.append(FileGroup(robot, [file]))
            newest.append(-1 if first is None else first)
    groups.sort(key=lambda group: not any(each.name.startswith(path.name) for each in group.files))
    if not groups:
        return [FileGroup("", files)]
    first_group = groups[0]
    together = [file for file in files if file in first_group.files or file in loose]
    return [FileGroup(first_group.robot, together), *groups[1:]]


def _identity(file: Path) -> tuple[str, int | None]:
    """Return the robot of a file and the `seq` of its first journal entry, None if it has none."""
    with Recording(file) as recording:
        info = recording.info()
        topic = journal_topic(info)
        robot = info.metadata.get(INFO_RECORD, {}).get("robot", "")
        if topic is None:
            return robot, None
        messages = recording.in_order_written({topic}, lambda sentence: None)
        entry = next((decode(message.data) for message in messages), None)
        return robot, None if entry is None else entry.seq


Readers = Mapping[str, Callable[[Message], None]]
"""The message handler of each compared topic."""


class CheckReading:
    """Reads a recording once, in file order, and groups its journal into steps.

    `end_ns` is the steady time of the last entry read so far, `chain` the CRC of all of them.
    """

    def __init__(
        self,
        recording: Recording,
        report: Report,
        ends: RecordingEnds,
        on_progress: Callable[[int, int], None],
    ) -> None:
        self._recording = recording
        self._report = report
        self._ends = ends
        self._on_progress = on_progress
        self._decoder = EntryDecoder(recording)
        self.chain = JournalChain()
        self.end_ns = 0
        self._log_ns: LogTimes = (0, 0)
        self._step: Step | None = None
        """The step that is being read: more effects may follow."""

    def items(self, topic: str, readers: Readers) -> Iterator[tuple[Item, LogTimes]]:
        """Yield each step, snapshot and gap of the journal on `topic`, with two log times [ns].

        The times are those of the last two events or snapshots read so far. For each message of
        another topic, call its handler in `readers` as it is read.

        Raises:
            UnreadableFile: The journal cannot be read.
        """
        order, last_ns = EntryOrder(), 0
        for message in self._recording.in_order_written(
            {topic, *readers}, self._report.miss, self._on_progress
        ):
            if message.topic != topic:
                readers[message.topic](message)
                continue
            entry = self._decoder.decode(message.data)
            self._note(entry, message)
            last_ns = message.log_ns
            if entry.kind is not EntryKind.EFFECT:
                self._log_ns = self._log_ns[1], last_ns
            for item in order.accept(entry):
                yield from self._grouped(item)
        self._log_ns = self._log_ns[1], max(self._log_ns[1], last_ns)  # of the last step
        for item in order.rest():
            yield from self._grouped(item)
        yield from self._ended(is_cut=True)

    def _note(self, entry: JournalEntry, message: Message) -> None:
        if not self._report.begin_log_ns:
            self._ends.origin.first(message)
            self._report.begin_ns, self._report.begin_log_ns = entry.t_ns, message.log_ns
        self.end_ns = entry.t_ns
        self.chain.add(entry.seq, message.data)
        self._ends.entry(entry.seq)

    def _grouped(self, item: JournalEntry | Gap) -> Iterator[tuple[Item, LogTimes]]:
        """Append an effect to the current step; for other items, yield the step, then the item."""
        if isinstance(item, Gap):
            yield from self._ended(is_cut=True)
            yield item, self._log_ns
        elif item.kind is EntryKind.EFFECT:
            if self._step is not None:
                self._step.effects.append(item)
        else:
            yield from self._ended()
            if item.kind is EntryKind.EVENT:
                self._step = Step(item)
            else:
                yield item, self._log_ns

    def _ended(self, *, is_cut: bool = False) -> Iterator[tuple[Item, LogTimes]]:
        """Yield the current step, if any; `is_cut` says that some of its effects may be missing."""
        step, self._step = self._step, None
        if step is not None:
            step.cut = is_cut
            yield step, self._log_ns


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
    if the recording is small. If `source` is given, it is the content of one MCAP file, of which
    only what the check needs is read; `path` is then only the name for the report.
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
    """Re-runs and compares each item of one recording, in file order, and fills the report."""

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
        """The two log times that `CheckReading.items` yielded with the current item."""

    def run(self) -> None:
        """Fill the report.

        Raises:
            UnreadableFile: The recording has no journal, or cannot be read at all.
        """
        report, info = self._report, self._info
        for sentence in self._recording.missing:
            report.miss(sentence, is_outside=not self._recording.lacks_parts)
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
        self._proofs.check(entry, snapshot.proof, self._ends.snapshot(entry, snapshot))
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
        """Re-run one step. Return its event and effects (the recorded ones if it was not re-run).

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
