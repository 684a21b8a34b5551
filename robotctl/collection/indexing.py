"""Indexes one recording, with rows from its journal, events and counts, and its verdicts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any, Final

from robotctl.base.errors import RobotctlError, UnreadableFile
from robotctl.base.processes import Report
from robotctl.check.journal import Gap, Step, decide, read_effect, read_event, read_snapshot, steps
from robotctl.check.run import check_recording
from robotctl.collection.index_file import (
    DriveRow,
    EventRow,
    IndexRow,
    RecordingRow,
    SampleRow,
    TopicRow,
    closed_files,
    files_of,
    index_path,
    stamp_of,
    write_index,
)
from robotctl.kernel.codec import finite_or_none, to_json
from robotctl.kernel.constants import NS_PER_S
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.types import (
    DriveEnded,
    DriveRequested,
    Effect,
    Event,
    ModeChanged,
    ModeRequested,
    Reply,
    Tick,
)
from robotctl.recording import Recording, RecordingInfo
from robotctl.recording.format.journal import JournalEntry
from robotctl.recording.format.names import INFO_RECORD, OWN_LIBRARY, SOFTWARE_RECORD
from robotctl.recording.format.topics import read_ledger
from robotctl.recording.read.journal_reader import read_journal
from robotctl.recording.read.whole_recording import verify_recording

SAMPLE_PERIOD_NS = NS_PER_S // 10
"""The time between two samples while the robot moves."""

VELOCITY = "velocity"
"""The `pattern` of a drive that holds a velocity instead of following a path."""

STOPS = (Mode.ERROR, Mode.EMERGENCY_STOP)

_DIGEST = "digest"
"""The key of the digest over all modules in the software record."""


def rows_of(
    path: Path, check: str, check_says: str | None, verify: str, files: Sequence[Path] = ()
) -> list[IndexRow]:
    """Return the index rows of a recording, with the given verdicts in the first row.

    `files` are the files of the folder to read; all are read if it is empty.

    Raises:
        UnreadableFile: Nothing can be read from the recording.
    """
    with Recording(path, files=files) as recording:
        info = recording.info()
        history = _History(recording, info)
        with suppress(UnreadableFile):  # no journal, or a damaged one: use what was read
            history.read()
    topics = list(_topics(info))
    drives = history.drives()
    events = [*_recorded_events(info), *history.events]
    metadata = info.metadata.get(INFO_RECORD, {})
    row = RecordingRow(
        robot=metadata.get("robot", ""),
        start_ns=info.start_ns,
        duration_s=info.duration_s,
        size_bytes=info.size_bytes,
        files=len(info.files),
        messages=info.message_count,
        lost=sum(topic.lost for topic in topics),
        version=metadata.get("robotctl", info.library.removeprefix(OWN_LIBRARY)),
        software=info.metadata.get(SOFTWARE_RECORD, {}).get(_DIGEST, ""),
        parameters=history.parameters,
        drives=len(drives),
        laps=sum(drive.laps or 0 for drive in drives),
        distance_m=sum(drive.distance_m or 0.0 for drive in drives),
        max_error_m=max((d.max_error_m for d in drives if d.max_error_m is not None), default=None),
        stops=history.stops,
        check=check,
        check_says=check_says,
        verify=verify,
    )
    return [row, *drives, *events, *topics, *history.samples]


def _topics(info: RecordingInfo) -> Iterator[TopicRow]:
    ledger = read_ledger(info.metadata)
    for topic in info.topics:
        counts = ledger.get(topic.name, {})
        yield TopicRow(
            topic=topic.name,
            type=topic.type_name,
            messages=topic.message_count,
            lost=counts.get("dropped", 0) + counts.get("lost", 0),
            rate_hz=topic.rate_hz,
        )


def _recorded_events(info: RecordingInfo) -> Iterator[EventRow]:
    for event in info.events:
        yield EventRow(event.kind.value, event.log_ns, None, event.text)


class _History:
    """Reads the journal once, and repeats the decisions in a kernel for pose and error."""

    def __init__(self, recording: Recording, info: RecordingInfo) -> None:
        self._recording = recording
        self._robot = info.metadata.get(INFO_RECORD, {}).get("robot", "")
        self._offset_ns = 0
        """The time since the epoch at steady time 0 [ns]."""

        self._kernel: Kernel | None = None
        self._mode: Mode | None = None
        self._asked: dict[int, DriveRequested | ModeRequested] = {}
        self._drives: dict[int, DriveRow] = {}
        """The row of each drive by request id, in the order of `DriveRow.drive`."""

        self._present: int | None = None
        self._sampled_ns = 0
        self.parameters: str | None = None
        self.stops = 0
        self.events: list[EventRow] = []
        self.samples: list[SampleRow] = []

    def read(self) -> None:
        """Read the whole journal, or raise UnreadableFile at a damaged entry."""
        for item in steps(self._entries()):
            if isinstance(item, Gap):
                self._kernel = None
            elif isinstance(item, Step):
                self._step(item)
            else:
                self._snapshot(item)

    def drives(self) -> list[DriveRow]:
        """Return the drives in their order."""
        return list(self._drives.values())

    def _entries(self) -> Iterator[JournalEntry]:
        for log_ns, entry in read_journal(self._recording, lambda text: None):
            self._offset_ns = log_ns - entry.t_ns
            yield entry

    def _snapshot(self, entry: JournalEntry) -> None:
        self._kernel = None
        with suppress(UnreadableFile):  # of another version
            snapshot = read_snapshot(entry)
            self._kernel, self._mode = snapshot.kernel(), snapshot.state.mode
            if self.parameters is None:
                self.parameters = to_json(snapshot.params)

    def _step(self, step: Step) -> None:
        try:
            event = read_event(step.event)
        except UnreadableFile:  # of another version
            self._kernel = None
            return
        if isinstance(event, DriveRequested | ModeRequested):
            self._asked[event.request_id] = event
        if self._kernel is not None:
            try:
                decide(self._kernel, event)
            except UnreadableFile:
                self._kernel = None
        self._follow(event.t_ns)
        for entry in step.effects:
            if entry.name != "PublishTwist":
                with suppress(UnreadableFile):
                    self._effect(event, read_effect(entry))
        if isinstance(event, Tick):
            self._sample(event.t_ns)

    def _follow(self, t_ns: int) -> None:
        """Add a row if the kernel has begun a drive."""
        drive = None if self._kernel is None else self._kernel.state.drive
        self._present = None if drive is None else drive.request_id
        if drive is not None and drive.request_id not in self._drives:
            asked = self._asked.get(drive.request_id)
            waypoints = drive.course.waypoints
            pattern = "waypoints" if waypoints else drive.pattern.kind.value
            self._drives[drive.request_id] = DriveRow(
                drive=len(self._drives) + 1,
                robot=self._robot,
                start_ns=t_ns + self._offset_ns,
                pattern=VELOCITY if drive.course.held else pattern,
                wanted_laps=drive.laps,
                asked_by="" if asked is None else asked.source,
            )

    def _effect(self, event: Event, effect: Effect) -> None:
        moment_ns = event.t_ns + self._offset_ns
        if isinstance(effect, ModeChanged):
            self._mode = effect.mode
            self.stops += effect.mode in STOPS
            cause = None if effect.cause is None else effect.cause.value
            self.events.append(EventRow("mode", moment_ns, effect.mode.name, effect.reason, cause))
        elif isinstance(effect, Reply) and not effect.ok:
            self.events.append(EventRow("refusal", moment_ns, effect.mode.name, effect.message))
        elif isinstance(effect, DriveEnded):
            self._end(event, effect)

    def _end(self, event: Event, ended: DriveEnded) -> None:
        """Complete the row of a drive, or add the row if the kernel could not follow the drive."""
        asked = self._asked.get(ended.request_id)
        row = self._drives.get(ended.request_id)
        has_path = row is None or row.pattern != VELOCITY
        report = ended.report if has_path else ended.report.without_errors()
        begin_ns = event.t_ns if asked is None else asked.t_ns
        source = "" if asked is None else asked.source
        number, start_ns = len(self._drives) + 1, begin_ns + self._offset_ns
        self._drives[ended.request_id] = replace(
            row or DriveRow(number, self._robot, start_ns, None, None, source),
            asked_by=source,
            duration_s=finite_or_none(report.duration_s),
            laps=report.laps,
            completed=ended.completed,
            ended=ended.reason,
            cause=None if ended.cause is None else ended.cause.value,
            distance_m=finite_or_none(report.distance_m),
            rms_error_m=finite_or_none(report.cross_track_rms_m),
            max_error_m=finite_or_none(report.cross_track_max_m),
            closure_m=finite_or_none(report.closure_m),
            rms_heading_rad=finite_or_none(report.heading_rms_rad),
            max_heading_rad=finite_or_none(report.heading_max_rad),
        )

    def _sample(self, t_ns: int) -> None:
        if self._kernel is None or self._mode is not Mode.MOVING:
            return
        if t_ns - self._sampled_ns < SAMPLE_PERIOD_NS:
            return
        self._sampled_ns = t_ns
        state = self._kernel.state
        odometry, drive = state.health.odometry, state.drive
        row = None if self._present is None else self._drives.get(self._present)
        pose = None if odometry is None else odometry.pose
        self.samples.append(
            SampleRow(
                drive=None if row is None else row.drive,
                start_ns=t_ns + self._offset_ns,
                mode=state.mode.name,
                x_m=None if pose is None else _rounded(pose.x),
                y_m=None if pose is None else _rounded(pose.y),
                theta_rad=None if pose is None else _rounded(pose.theta),
                linear_mps=_rounded(state.command.linear),
                angular_rps=_rounded(state.command.angular),
                error_m=None if drive is None else _rounded(drive.score.error_m),
            )
        )


def _rounded(value: float) -> float | None:
    """Return a value rounded to 0.1 mm or 0.1 mrad, None if not finite."""
    return round(value, 4) if isfinite(value) else None


NOT_CHECKED: Final = "not checked"
"""Both verdicts of a recording that is still being made."""


def index_recording(recording: Path) -> str:
    """Check, verify and index a recording; return "", or the reason of a failure.

    Of a recording that is still being made, only the closed files are indexed, unchecked.
    """
    try:
        files = files_of(recording)
        closed = closed_files(files)
        stamp = stamp_of(closed)
        if len(closed) < len(files):
            rows = rows_of(recording, NOT_CHECKED, None, NOT_CHECKED, closed)
        else:
            verify = verify_recording(recording).proof.value
            report = check_recording(recording)
            says = [each.text for each in report.violations] + report.missing
            rows = rows_of(recording, report.verdict.value, says[0] if says else None, verify)
        write_index(index_path(recording), recording.name, rows, stamp)
    except (RobotctlError, OSError) as error:
        return str(error)  # as text: this runs in another process
    return ""


def index_job(given: dict[str, Any], report: Report) -> None:
    """Index the recording with the path `given["recording"]`; the daemon runs this as a process.

    Raises:
        RobotctlError: The recording was not indexed.
    """
    failure = index_recording(Path(given["recording"]))
    if failure:
        raise RobotctlError(failure)
