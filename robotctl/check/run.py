"""Check a recording: re-run its decisions in a new kernel, and compare the recorded messages."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

from robotctl.base.errors import UnreadableFile
from robotctl.base.store import RemoteFile, path_of
from robotctl.check.calls import ServiceChecks
from robotctl.check.commands import CommandCheck
from robotctl.check.compare import Comparison, JournalFormat, Rerun, without_retired_fields
from robotctl.check.ends import (
    EndingOf,
    JournalChain,
    JournalEnd,
    JournalOrigin,
    RecordingEnds,
    SnapshotProofs,
    check_types,
)
from robotctl.check.inputs import InputChecks
from robotctl.check.invariants import Invariants
from robotctl.check.journal import (
    MAX_DISORDER,
    Gap,
    Moments,
    Step,
    read_effect,
    read_snapshot,
    steps,
)
from robotctl.check.report import Divergence, Report
from robotctl.check.statuses import StatusCheck
from robotctl.check.times import ClockChanges, MeasurementOrder, RecordedStalls, TickSchedule
from robotctl.check.topics import RobotTopics
from robotctl.kernel.codec import Snapshot
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.types import Effect, Event, OdomReceived
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.journal import EntryKind, JournalEntry, decode
from robotctl.recording.format.names import INFO_RECORD, OWN_LIBRARY
from robotctl.recording.read.files import Source, recording_files
from robotctl.recording.read.journal_reader import EntryDecoder, journal_topic, journal_topics
from robotctl.recording.read.messages import Message
from robotctl.recording.read.whole_file import SealState
from robotctl.recording.read.whole_recording import VerifiedRecording, verify_recording


def file_groups(path: Path) -> list[list[Path]]:
    """Return the files of `path` grouped by recording, the group with the name of `path` first.

    Unreadable files are in the first group.

    Raises:
        UnreadableFile: `path` is not a recording.
    """
    files = recording_files(path)
    groups: list[list[Path]] = []
    known: list[tuple[str, int]] = []
    """The robot of each group, and the highest of its first entries."""

    loose: list[Path] = []
    for file in files if len(files) > 1 else ():
        try:
            robot, first = _identity(file)
        except UnreadableFile:
            loose.append(file)
            continue
        fits = (name == robot and (first is None or first > seq) for name, seq in known)
        at = next((number for number, fit in enumerate(fits) if fit), len(groups))
        if at == len(groups):
            groups.append([])
            known.append((robot, -1))
        groups[at].append(file)
        known[at] = robot, known[at][1] if first is None else first
    groups.sort(key=lambda group: not any(each.name.startswith(path.name) for each in group))
    if not groups:
        return [files]
    groups[0] = [file for file in files if file in groups[0] or file in loose]
    return groups


def _identity(file: Path) -> tuple[str, int | None]:
    """Return the robot of a file and the `seq` of its first journal entry, None without one."""
    with Recording(file) as recording:
        info = recording.info()
        topic = journal_topic(info)
        robot = info.metadata.get(INFO_RECORD, {}).get("robot", "")
        if topic is None:
            return robot, None
        messages = recording.in_order_written({topic}, lambda sentence: None)
        entry = next((decode(message.data) for message in messages), None)
        return robot, None if entry is None else entry.seq


Compared = InputChecks | StatusCheck | CommandCheck | ServiceChecks
"""A comparison of messages with the journal."""


class Comparisons:
    """The invariants, and the comparisons of commands, inputs, services and statuses."""

    def __init__(self, report: Report, invariants: Invariants, topics: RobotTopics) -> None:
        self._report = report
        self._invariants = invariants
        clock = self._clock = ClockChanges()
        self._stalls = RecordedStalls()
        self._ticks = TickSchedule()
        self._order = MeasurementOrder()
        self._of_all: tuple[Compared, ...] = (
            InputChecks(report, topics, self._stalls),
            StatusCheck(report, topics, clock),
        )
        """The comparisons of each step."""

        self._of_decisions: tuple[Compared, ...] = (
            CommandCheck(report, topics, clock),
            ServiceChecks(report, topics, clock),
        )
        """The comparisons that skip odometry without effects."""

        self._all = self._of_decisions + self._of_all

    def readers(self) -> dict[str, Callable[[Message], None]]:
        """Return the message handler of each compared topic."""
        return {topic: read for each in self._all for topic, read in each.readers().items()}

    def snapshot(self, snapshot: Snapshot, t_ns: int, log_ns: int) -> None:
        """Begin or continue comparing at a snapshot; `t_ns` is steady, `log_ns` since the epoch."""
        self._invariants.snapshot(snapshot)
        self._ticks.begin(snapshot.params.rate_hz)
        for each in self._all:
            each.snapshot(snapshot, t_ns, log_ns)

    def step(self, seq: int, event: Event, effects: tuple[Effect, ...], moments: Moments) -> None:
        """Compare a step; `seq` is the number of its event, `moments` are its times."""
        self._order.step(event, seq)
        self._stalls.step(event)
        for each in self._of_all:
            each.step(seq, event, effects, moments)
        if not effects and isinstance(event, OdomReceived):
            return
        self._ticks.step(event, seq)
        for each in self._of_decisions:
            each.step(seq, event, effects, moments)
        self._invariants.step(seq, event, effects)

    def stop(self) -> None:
        """Stop comparing until the next snapshot."""
        self._invariants.stop()
        self._ticks.stop()
        self._order.stop()
        for each in self._all:
            each.stop()

    def end(self, ending: EndingOf, end_ns: int, log_ns: int) -> None:
        """Report the differences; the journal ends at `end_ns` (steady), `log_ns` (epoch)."""
        self._ticks.stop()
        for found in self._ticks.missing:
            self._invariants.violate(f"{found.ticks} ticks are missing before entry {found.seq}")
        if swapped := self._order.swapped:
            text = f"{swapped} measurements are earlier than one before them"
            self._invariants.violate(f"{text}, the first is entry {self._order.first_seq}")
        moment = JournalEnd(end_ns, log_ns, self._stalls.recent_ns(end_ns), self._clock.has_changed)
        for each in self._all:
            each.end(ending, moment)
        if self._clock.note and ending(None).is_own:
            self._report.notes.append(self._clock.note)


ALL_BYTES_BELOW: Final = 100_000_000
"""A recording smaller than this [bytes] is always read completely."""

UNNUMBERED: Final = (
    "its messages have no sequence numbers, as in every bag of rosbag2: not compared with the "
    "journal are commands, inputs, statuses and calls"
)

_KEY_DIGITS = 16


def check_bytes(path: Path, report: Report, *, all_bytes: bool) -> None:
    """Read every byte of a recording if it is below ALL_BYTES_BELOW or `all_bytes` is set.

    Flaws are added to `report.missing`; a broken seal does not change the verdict.
    """
    try:
        size = sum(file.stat().st_size for file in recording_files(path))
        if not all_bytes and size >= ALL_BYTES_BELOW:
            report.notes.append("not every byte was read: --all-bytes reads them all")
            return
        found = verify_recording(path)
    except (OSError, UnreadableFile):
        return  # the check has reported why
    for sentence in (*found.unreadable, *found.flaws):
        if sentence not in report.missing:
            report.miss(sentence)
    report.seal = _seal_line(found)


def _seal_line(found: VerifiedRecording) -> str:
    """Return one line about the seals, or "" if there is no seal."""
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

    An unreadable file is named in the report. Every byte is read if `all_bytes` is set, or if a
    local recording is below ALL_BYTES_BELOW. `source`, if given, is one MCAP file; `path` is then
    only the name for the report.
    """
    report = Report(path)
    began = time.perf_counter()
    others: list[list[Path]] = []
    try:
        files: list[Path] = []
        if source is None:
            files, *others = file_groups(path)
        with Recording(path, source=source, files=files if others else ()) as recording:
            _Check(recording, report, on_progress).run()
    except UnreadableFile as error:
        report.miss(str(error))
    for file in chain.from_iterable(others):
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


def check_recordings(
    paths: Sequence[Path],
    on_progress: Progress = lambda done, total: None,
    *,
    all_bytes: bool = False,
) -> list[dict[str, Any]]:
    """Check each path as `check_recording` does; return the JSON reports in the same order.

    Several are checked in one process per CPU; `on_progress` then counts recordings, not bytes.
    """
    if len(paths) == 1:
        return [check_recording(paths[0], on_progress, all_bytes=all_bytes).as_object()]
    from robotctl.base.pool import local_processes, results_of  # here: one check needs no processes

    results = results_of(partial(_checked, all_bytes), paths, local_processes, on_progress)
    reports = dict(results)
    return [reports[path] or _lost(path) for path in paths]


def _checked(all_bytes: bool, path: Path) -> dict[str, Any]:
    return check_recording(path_of(str(path)), all_bytes=all_bytes).as_object()


def _lost(path: Path) -> dict[str, Any]:
    report = Report(path)
    report.miss("the process that checked it was killed")
    return report.as_object()


class _Check:
    """Re-runs and compares each item of one recording, and fills the report."""

    def __init__(self, recording: Recording, report: Report, on_progress: Progress) -> None:
        self._recording = recording
        self._report = report
        self._on_progress = on_progress
        self._info = recording.info()
        self._format = JournalFormat(report)
        self._invariants = Invariants()
        self._rerun: Rerun | None = None
        self._before_snapshot = 0
        self._decoder = EntryDecoder(recording)
        self._has_numbers = True
        """Whether messages have sequence numbers; rosbag2 writes 0."""

        self._chain = JournalChain()
        """The CRC of all entries so far."""

        self._end_ns = 0
        """The steady time of the last entry."""

        self._logged: dict[int, int] = {}
        """Log times [ns] of events and snapshots that wait for their comparison, by `seq`."""

        self._logged_ns = 0
        """The log time of the last entry [ns]."""

        report.robot = self._info.metadata.get(INFO_RECORD, {}).get("robot", "")
        report.version = _version(self._info)

    def run(self) -> None:
        """Fill the report.

        Raises:
            UnreadableFile: The recording has no journal, or cannot be read at all.
        """
        report, info = self._report, self._info
        for sentence in self._recording.missing:
            report.miss(sentence, is_outside=not self._recording.lacks_parts)
        self._topic = topic = journal_topic(info)
        if topic is None:
            raise UnreadableFile("it holds no journal of robotctl: there are no decisions to check")
        for other in sorted(journal_topics(info) - {topic}):
            report.notes.append(f"the journal {other} of another robot was not checked")
        invariants, origin = self._invariants, JournalOrigin(info, topic)
        self._ends = RecordingEnds(self._recording, info, report, invariants, origin)
        self._compared = Comparisons(report, invariants, RobotTopics(info, topic))
        self._proofs = SnapshotProofs(report, self._chain, invariants)
        report.violations = invariants.violations
        try:
            for item in steps(self._entries(topic)):
                if isinstance(item, Step):
                    self._step(item)
                elif isinstance(item, Gap):
                    report.miss(item.text)
                    self._stop()
                else:
                    self._snapshot(item)
            self._end()
        finally:
            report.violation_count = invariants.count

    def _entries(self, topic: str) -> Iterator[JournalEntry]:
        """Yield the entries of the journal in the order of the file; compare other messages.

        Raises:
            UnreadableFile: The journal cannot be read.
        """
        readers = self._compared.readers()
        for message in self._recording.in_order_written(
            {topic, *readers}, self._report.miss, self._on_progress
        ):
            if message.topic != topic:
                readers[message.topic](message)
                continue
            entry = self._decoder.decode(message.data)
            self._begin_or_continue(entry, message)
            self._logged_ns = message.log_ns
            if entry.kind is not EntryKind.EFFECT:
                self._logged[entry.seq] = message.log_ns
                if len(self._logged) > 2 * MAX_DISORDER:
                    del self._logged[next(iter(self._logged))]
            yield entry

    def _begin_or_continue(self, entry: JournalEntry, message: Message) -> None:
        if not self._report.begin_log_ns:
            self._ends.origin.first(message)
            self._has_numbers = bool(message.sequence)
            self._report.begin_ns, self._report.begin_log_ns = entry.t_ns, message.log_ns
        self._end_ns = entry.t_ns
        self._chain.add(entry.seq, message.data)
        self._ends.entry(entry.seq)

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
        if not self._has_numbers:
            snapshot = replace(snapshot, proof=None)
        log_ns = self._logged.pop(entry.seq, self._logged_ns)
        self._compared.snapshot(snapshot, entry.t_ns, log_ns)

    def _step(self, step: Step) -> None:
        entry, report, rerun = step.event, self._report, self._rerun
        report.events += 1
        report.effects += len(step.effects)
        try:
            if rerun is None:
                self._before_snapshot += 1
                return
            event, effects = self._decided(rerun, step)
        except UnreadableFile as error:
            self._interrupt_at(error)
            return
        begin_ns = self._logged.pop(entry.seq, self._logged_ns)
        end_ns = self._logged.get(entry.seq + 1 + len(step.effects), self._logged_ns)
        self._compared.step(entry.seq, event, effects, (event.t_ns, begin_ns, end_ns))

    def _decided(self, rerun: Rerun, step: Step) -> tuple[Event, tuple[Effect, ...]]:
        """Re-run one step, and return its event and effects, or the recorded effects.

        Raises:
            UnreadableFile: An entry cannot be read.
        """
        report = self._report
        self._format.compare(step.event, *step.effects)
        event, effects, divergence = rerun.step(step)
        if effects is None or not (report.bitwise or step.cut):
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
        """Report an unreadable entry, and pause until the next snapshot."""
        report = self._report
        (report.miss if report.same_version else report.miss_other_rules)(str(error))
        self._stop()

    def _stop(self) -> None:
        """Pause re-run and comparisons until the next snapshot."""
        self._compared.stop()
        if self._rerun is not None:
            self._rerun.stop()

    def _end(self) -> None:
        report, ends, invariants = self._report, self._ends, self._invariants
        report.duration_s = (self._end_ns - report.begin_ns) / NS_PER_S
        if self._rerun is None:
            report.miss("its journal holds no snapshot of the kernel to begin from")
            return
        if self._before_snapshot:
            report.notes.append(f"{self._before_snapshot} events before the first snapshot")
        if not self._has_numbers:
            report.miss(UNNUMBERED)
        check_types(self._recording, report, {self._topic, *self._compared.readers()})
        ends.check(self._before_snapshot)
        kernel = self._rerun.kernel
        if kernel is not None:
            invariants.end(kernel.state.waiting)
        self._compared.end(ends.ending, self._end_ns, self._logged_ns)


def _version(info: RecordingInfo) -> str:
    """Return the version of robotctl that made the recording, "" if unknown."""
    known = info.metadata.get(INFO_RECORD, {}).get("robotctl", "")
    if known or not info.library.startswith(OWN_LIBRARY):
        return known
    return info.library.removeprefix(OWN_LIBRARY)
