"""Reads the data of a report from a recording's journal or, without one, its topics."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import hypot, isfinite, sqrt
from pathlib import Path
from typing import Final

from robotctl.base.errors import UnreadableFile
from robotctl.check.journal import KERNEL_FAILURES, decide, read_effect, read_event, read_snapshot
from robotctl.check.why import sentence_of
from robotctl.kernel.constants import NS_PER_S, TWIST, TWIST_STAMPED
from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.odometry import is_finite
from robotctl.kernel.types import (
    BatteryReceived,
    DriveEnded,
    DriveReport,
    Event,
    FaultReported,
    LoopStalled,
    ModeChanged,
    OdomReceived,
    ParameterChanged,
    Phase,
    PublishTwist,
    Reply,
    Tick,
    Twist,
)
from robotctl.messages.cdr import ODOMETRY
from robotctl.messages.inputs import (
    decode_twist,
    decode_twist_stamped,
    read_battery_level,
    read_sample,
)
from robotctl.recording import Recording, RecordingInfo, TopicInfo
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.format.names import OWN_LIBRARY, EventKind
from robotctl.recording.format.noted_events import NOTED_MODES
from robotctl.recording.format.topics import read_ledger
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import EntryDecoder, journal_topic
from robotctl.show.series import Series, ThinnedPath, is_on_earth

MAX_SPANS: Final = 150
MAX_MOMENTS: Final = 100
MAX_DRIVES: Final = 50
MAX_WANTED_POINTS: Final = 8_000
"""Limits on the modes, moments and drives that are kept, and on the points of all wanted paths."""

RATE_COLUMNS: Final = 60
"""Columns of the small picture of a topic's rate."""

Point = tuple[float, float]


@dataclass(slots=True)
class ModeSpan:
    """A time span in which the robot was in one mode; `reason` says why it entered the mode."""

    begin_s: float
    end_s: float
    mode: str
    reason: str


@dataclass(frozen=True, slots=True)
class TracedMoment:
    """Something that happened during the recording."""

    t_s: float
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class EndedDrive:
    """A drive that ended, with its report."""

    t_s: float
    reason: str
    report: DriveReport


class Rates:
    """The message counts of each topic in RATE_COLUMNS equal time spans, and its longest pause."""

    def __init__(self, duration_s: float) -> None:
        self.counts: dict[str, list[int]] = {}
        self.pauses_s: dict[str, float] = {}
        self._last_s: dict[str, float] = {}
        self._per_s = RATE_COLUMNS / duration_s if duration_s > 0.0 else 0.0

    def add(self, topic: str, t_s: float) -> None:
        """Count a message of a topic at `t_s` [s into the recording]."""
        counts = self.counts.get(topic)
        if counts is None:
            counts = self.counts[topic] = [0] * RATE_COLUMNS
        counts[min(max(int(t_s * self._per_s), 0), RATE_COLUMNS - 1)] += 1
        pause_s = t_s - self._last_s.get(topic, t_s)
        self.pauses_s[topic] = max(self.pauses_s.get(topic, 0.0), pause_s)
        self._last_s[topic] = t_s


class Traces:
    """The data that a report draws, with times in seconds from the first message."""

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s
        self.driven = ThinnedPath()
        self.wanted: list[list[Point]] = []
        self.modes: list[ModeSpan] = []
        self.moments: list[TracedMoment] = []
        self.drives: list[EndedDrive] = []
        self.left_out = 0
        """The number of modes, moments, drives and wanted paths that the limits have left out."""

        self.commanded_linear, self.commanded_angular, self.linear, self.angular = (
            Series(duration_s) for _ in range(4)
        )
        self.error, self.battery, self.lateness = (Series(duration_s) for _ in range(3))
        self.rates = Rates(duration_s)

    def enter_mode(self, t_s: float, mode: str, reason: str) -> None:
        """Begin a span at `t_s`, or extend the last span if mode and reason are unchanged."""
        if self.modes:
            self.modes[-1].end_s = t_s
            if self.modes[-1].mode == mode and self.modes[-1].reason == reason:
                return
        if self._has_room(self.modes, MAX_SPANS):
            self.modes.append(ModeSpan(t_s, t_s, mode, reason))

    def happened(self, t_s: float, kind: str, text: str) -> None:
        """Add something that happened at `t_s`; after MAX_MOMENTS, only count it as left out."""
        if self._has_room(self.moments, MAX_MOMENTS):
            self.moments.append(TracedMoment(t_s, kind, text))

    def drive_ended(self, drive: EndedDrive) -> None:
        """Add the end of a drive; after MAX_DRIVES, count it as left out."""
        if self._has_room(self.drives, MAX_DRIVES):
            self.drives.append(drive)

    def want(self, outline: list[Point]) -> None:
        """Add a reference path as its outline, or only count it if it is invalid or too long."""
        has_room = sum(map(len, self.wanted)) + len(outline) <= MAX_WANTED_POINTS
        if outline and has_room and all(is_on_earth(x, y) for x, y in outline):
            self.wanted.append(outline)
        else:
            self.left_out += 1

    def close(self) -> None:
        """Extend the last mode to the end of the recording."""
        if self.modes:
            self.modes[-1].end_s = max(self.duration_s, self.modes[-1].begin_s)

    def series(self) -> Iterator[Series]:
        """Yield each series of values that the plots show, such as speed and battery level."""
        yield from (self.commanded_linear, self.linear, self.commanded_angular, self.angular)
        yield from (self.error, self.battery, self.lateness)

    def _has_room(self, kept: Sequence[object], limit: int) -> bool:
        if len(kept) < limit:
            return True
        self.left_out += 1
        return False


MS_PER_NS: Final = 1e-6


class JournalTraces:
    """Fills traces from the entries of a journal, in their order.

    A kernel that replays the entries computes some values; after a gap it awaits a snapshot.
    """

    def __init__(self, traces: Traces) -> None:
        self._traces = traces
        self._kernel: Kernel | None = None
        self._next_seq: int | None = None
        self._tick_ns: int | None = None
        self._outlined: tuple[int, Pose] | None = None

    def take(self, entry: JournalEntry, t_s: float) -> None:
        """Add the content of an entry to the traces; `t_s` is its time [s into the recording].

        Raises:
            UnreadableFile: This version cannot read the entry; later entries can still be added.
        """
        if entry.seq != self._next_seq:
            self._kernel = self._tick_ns = None
        self._next_seq = entry.seq + 1
        if entry.kind is EntryKind.SNAPSHOT:
            self._snapshot(entry, t_s)
        elif entry.kind is EntryKind.EVENT:
            self._event(read_event(entry), t_s)
        else:
            self._effect(entry, t_s)

    def _snapshot(self, entry: JournalEntry, t_s: float) -> None:
        snapshot = read_snapshot(entry)
        self._kernel = snapshot.kernel()
        if not self._traces.modes:
            self._traces.enter_mode(t_s, snapshot.state.mode.name, snapshot.state.reason)

    def _event(self, event: Event, t_s: float) -> None:
        traces, kernel = self._traces, self._kernel
        if kernel is not None:
            try:
                decide(kernel, event)
            except UnreadableFile:
                self._kernel = None
                raise
        match event:
            case Tick():
                self._tick(event, t_s)
            case OdomReceived():
                odometry = event.odometry
                if is_finite(odometry):
                    traces.driven.add(t_s, odometry.pose.x, odometry.pose.y)
                    self._follow(odometry.pose, t_s)
                traces.linear.add(t_s, odometry.velocity.linear)
                traces.angular.add(t_s, odometry.velocity.angular)
            case BatteryReceived() if kernel is not None:
                level = kernel.state.health.battery_level
                if level is not None:
                    traces.battery.add(t_s, 100.0 * level)
            case LoopStalled():
                traces.happened(t_s, "stall", sentence_of(event))
            case FaultReported():
                traces.happened(t_s, event.cause.value, event.detail)
            case _:
                pass

    def _tick(self, event: Tick, t_s: float) -> None:
        kernel, before_ns = self._kernel, self._tick_ns
        self._tick_ns = event.t_ns
        if kernel is not None and before_ns is not None:
            due_ns = before_ns + (event.missed + 1) * round(NS_PER_S / kernel.params.rate_hz)
            self._traces.lateness.add(t_s, (event.t_ns - due_ns) * MS_PER_NS)

    def _follow(self, pose: Pose, t_s: float) -> None:
        """Add the pose's distance from the wanted path, and a new path, or raise UnreadableFile."""
        state = None if self._kernel is None else self._kernel.state
        if state is None or state.drive is None or state.phase is not Phase.DRIVING:
            return
        drive = state.drive
        if not drive.path.segments:
            return
        try:
            self._traces.error.add(t_s, drive.cross_track_m(pose))
            if self._outlined != (drive.request_id, drive.origin):
                self._outlined = drive.request_id, drive.origin
                outline = map(drive.origin.compose, drive.path.outline())
                self._traces.want([(place.x, place.y) for place in outline])
        except KERNEL_FAILURES as error:
            self._kernel = None
            raise UnreadableFile(f"the wanted path cannot be drawn: {error}"[:200]) from None

    def _measured(self, ended: DriveEnded) -> DriveReport:
        """Return a drive's report, without tracking errors if there was no path to follow."""
        followed = self._outlined is not None and self._outlined[0] == ended.request_id
        known = followed or self._kernel is None
        return ended.report if known else ended.report.without_errors()

    def _effect(self, entry: JournalEntry, t_s: float) -> None:
        traces = self._traces
        match read_effect(entry):
            case PublishTwist(twist):
                traces.commanded_linear.add(t_s, twist.linear)
                traces.commanded_angular.add(t_s, twist.angular)
            case ModeChanged() as changed:
                traces.enter_mode(t_s, changed.mode.name, changed.reason)
                if changed.mode in NOTED_MODES:
                    traces.happened(t_s, NOTED_MODES[changed.mode].value, changed.reason)
            case DriveEnded() as ended:
                traces.happened(t_s, EventKind.DRIVE_ENDED.value, ended.reason)
                traces.drive_ended(EndedDrive(t_s, ended.reason, self._measured(ended)))
            case Reply(ok=False) as refused:
                traces.happened(t_s, "refused", refused.message)
            case ParameterChanged() as changed:
                text = f"{changed.key}: {changed.old} -> {changed.new}"
                traces.happened(t_s, "parameter", text)
            case _:
                pass


BATTERY: Final = "sensor_msgs/msg/BatteryState"

Taker = Callable[[Traces, float, bytes], None]
"""A function (traces, time [s], CDR bytes) that adds one message of a topic to the traces."""


def topic_takers(topics: Sequence[TopicInfo]) -> dict[tuple[str, str], Taker]:
    """Map the busiest odometry, command and battery topic to the function that reads it."""
    takers: dict[tuple[str, str], Taker] = {}
    kinds: tuple[dict[str, Taker], ...] = (
        {ODOMETRY: _take_odometry},
        {
            TWIST: partial(_take_command, decode_twist),
            TWIST_STAMPED: partial(_take_command, decode_twist_stamped),
        },
        {BATTERY: _take_battery},
    )
    for kind in kinds:
        found = [each for each in topics if each.type_name in kind and each.message_count]
        if found:
            chosen = max(found, key=lambda each: each.message_count)
            takers[chosen.name, chosen.type_name] = kind[chosen.type_name]
    return takers


def _take_odometry(traces: Traces, t_s: float, data: bytes) -> None:
    sample = read_sample(data)
    traces.driven.add(t_s, sample.x, sample.y)
    traces.linear.add(t_s, sample.linear)
    traces.angular.add(t_s, sample.angular)


def _take_command(
    decode: Callable[[bytes], Twist], traces: Traces, t_s: float, data: bytes
) -> None:
    try:
        twist = decode(data)
    except struct.error:
        traces.commanded_linear.odd += 1
        return
    traces.commanded_linear.add(t_s, twist.linear)
    traces.commanded_angular.add(t_s, twist.angular)


def _take_battery(traces: Traces, t_s: float, data: bytes) -> None:
    traces.battery.add(t_s, 100.0 * read_battery_level(data))


@dataclass(frozen=True, slots=True)
class Recorded:
    """The part of a recording's content that its report shows."""

    info: RecordingInfo
    traces: Traces
    has_journal: bool
    drawn: tuple[str, ...]
    """The drawn topics, empty for a recording with a journal."""
    missing: tuple[str, ...]
    """A sentence for each part that could not be read."""
    is_live: bool
    """Whether the recording is being written."""
    is_cut_off: bool
    """Whether robotctl wrote the recording, and did not close it."""


def read_recorded(
    path: Path, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Recorded:
    """Read a recording of robotctl or of another recorder, a file or a folder.

    Raises:
        UnreadableFile: Nothing can be read.
    """
    with Recording(path) as recording:
        info = recording.info()
        missing = list(recording.missing)

        def miss(sentence: str) -> None:
            note_missing(missing, sentence)

        traces = Traces(info.duration_s)
        journal, takers = journal_topic(info), topic_takers(info.topics)
        for event in info.events:
            if journal is None or event.kind is EventKind.MARK:  # the journal has all but marks
                t_s = (event.log_ns - info.start_ns) / NS_PER_S
                traces.happened(t_s, event.kind.value, event.text)
        from_journal, decoder = JournalTraces(traces), EntryDecoder(recording)
        for message in recording.in_order_written(None, miss, on_progress):
            t_s = (message.log_ns - info.start_ns) / NS_PER_S
            traces.rates.add(message.topic, t_s)
            if journal is None:
                if taker := takers.get((message.topic, message.type_name)):
                    taker(traces, t_s, message.data)
            elif message.topic == journal:
                try:
                    from_journal.take(decoder.decode(message.data), t_s)
                except UnreadableFile as error:
                    miss(str(error))
        traces.close()
        traces.moments.sort(key=lambda moment: moment.t_s)
        return Recorded(
            info=info,
            traces=traces,
            has_journal=journal is not None,
            drawn=() if journal is not None else tuple(topic for topic, _ in takers),
            missing=tuple(missing),
            is_live=recording.is_live,
            is_cut_off=recording.is_cut_off and info.library.startswith(OWN_LIBRARY),
        )


@dataclass(frozen=True, slots=True)
class KeyFigure:
    """A number that summarizes a recording, such as its duration."""

    key: str
    """The key of the figure in `--json`."""
    name: str
    value: float | None
    """None if the value is not known."""
    form: str
    unit: str

    @property
    def text(self) -> str:
        """The value with its unit, or "unknown"."""
        if self.value is None:
            return "unknown"
        return f"{self.value:{self.form}} {self.unit}".rstrip()


def figures_of(recorded: Recorded) -> list[KeyFigure]:
    """Return the key figures of a recording, in the order in which they are shown."""
    traces, info = recorded.traces, recorded.info
    ledger = read_ledger(info.metadata).values()
    lost = sum(counts.get("lost", 0) + counts.get("dropped", 0) for counts in ledger)
    rms_m, most_m = _cross_track(traces)
    drives = len(traces.drives) if recorded.has_journal else None
    speeds = [abs(each) for each in (traces.linear.least, traces.linear.most) if each is not None]
    levels = traces.battery.columns
    begin, end = (levels[0].first, levels[-1].last) if levels else (None, None)
    figures = [
        KeyFigure("duration_s", "Duration", info.duration_s, ".1f", "s"),
        KeyFigure("drives", "Drives", drives, "d", ""),
        KeyFigure("distance_m", "Distance", _distance(traces), ".2f", "m"),
        KeyFigure("cross_track_rms_m", "Off track, RMS", rms_m, ".3f", "m"),
        KeyFigure("cross_track_max_m", "Off track, at most", most_m, ".3f", "m"),
        KeyFigure("speed_max_mps", "Speed, at most", max(speeds, default=None), ".2f", "m/s"),
        KeyFigure("battery_begin", "Battery, begin", begin, ".1f", "%"),
        KeyFigure("battery_end", "Battery, end", end, ".1f", "%"),
        KeyFigure("tick_late_max_ms", "Tick late, at most", traces.lateness.most, ".1f", "ms"),
        KeyFigure("messages", "Messages", info.message_count, "d", ""),
        KeyFigure("lost", "Messages lost", lost if ledger else None, "d", ""),
    ]
    return [
        each if each.value is None or isfinite(each.value) else replace(each, value=None)
        for each in figures
    ]


def _distance(traces: Traces) -> float | None:
    if traces.drives:
        return sum(drive.report.distance_m for drive in traces.drives)
    places = traces.driven.whole()
    if not places:
        return None
    return sum(hypot(b.x - a.x, b.y - a.y) for a, b in pairwise(places))


def _cross_track(traces: Traces) -> tuple[float | None, float | None]:
    """Return the RMS over all drives and the largest cross-track error [m]."""
    reports = [
        report
        for report in (drive.report for drive in traces.drives)
        if isfinite(report.duration_s) and isfinite(report.cross_track_rms_m)
    ]
    time_s = sum(report.duration_s for report in reports)
    rms_m = None
    if time_s > 0.0:
        squares = (
            report.cross_track_rms_m * report.cross_track_rms_m * report.duration_s
            for report in reports
        )
        rms_m = sqrt(max(sum(squares) / time_s, 0.0))
    return rms_m, traces.error.most
