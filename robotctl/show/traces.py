"""What a report draws of a recording, from its journal or its topics."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

from robotctl.cdr.battery import read_battery_level
from robotctl.cdr.known_types import ODOMETRY
from robotctl.cdr.motion import decode_twist, decode_twist_stamped, read_sample
from robotctl.errors import UnreadableFile
from robotctl.kernel.command_types import TWIST, TWIST_STAMPED
from robotctl.kernel.geometry import Pose
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.odometry import is_finite
from robotctl.kernel.parameter_change import ParameterChanged
from robotctl.kernel.types import (
    BatteryReceived,
    DriveEnded,
    DriveReport,
    Event,
    FaultReported,
    LoopStalled,
    ModeChanged,
    OdomReceived,
    Phase,
    PublishTwist,
    Reply,
    Tick,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import TopicInfo
from robotctl.recording.format.event_kind import EventKind
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.format.noted_events import NOTED_MODES
from robotctl.recording.read.messages import Message
from robotctl.rerun.journal_values import (
    KERNEL_FAILURES,
    decide,
    read_effect,
    read_event,
    read_snapshot,
)
from robotctl.rerun.sentences import sentence_of
from robotctl.show.series import Series, ThinnedPath, is_on_earth

MAX_SPANS: Final = 150
MAX_MOMENTS: Final = 100
MAX_DRIVES: Final = 50
MAX_WANTED_POINTS: Final = 8_000
"""How much of each is kept; `Traces.left_out` counts the rest."""

RATE_COLUMNS: Final = 60
"""Columns of the small picture of a topic's rate."""

Point = tuple[float, float]


@dataclass(slots=True)
class ModeSpan:
    """A time in one mode, and why it began."""

    begin_s: float
    end_s: float
    mode: str
    reason: str


@dataclass(frozen=True, slots=True)
class TracedMoment:
    """Something that happened: its kind in a word, and what is known of it."""

    t_s: float
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class EndedDrive:
    """A drive that ended, and its figures."""

    t_s: float
    reason: str
    report: DriveReport


class Rates:
    """How many messages of each topic came in each part of the recording, and the longest pause."""

    def __init__(self, duration_s: float) -> None:
        self.counts: dict[str, list[int]] = {}
        self.pauses_s: dict[str, float] = {}
        self._last_s: dict[str, float] = {}
        self._per_s = RATE_COLUMNS / duration_s if duration_s > 0.0 else 0.0

    def add(self, topic: str, t_s: float) -> None:
        """Count a message."""
        counts = self.counts.get(topic)
        if counts is None:
            counts = self.counts[topic] = [0] * RATE_COLUMNS
        counts[min(max(int(t_s * self._per_s), 0), RATE_COLUMNS - 1)] += 1
        pause_s = t_s - self._last_s.get(topic, t_s)
        self.pauses_s[topic] = max(self.pauses_s.get(topic, 0.0), pause_s)
        self._last_s[topic] = t_s


@dataclass(slots=True)
class Traces:
    """The traces of one recording; times are in seconds from its first message."""

    duration_s: float
    driven: ThinnedPath = field(default_factory=ThinnedPath)
    wanted: list[list[Point]] = field(default_factory=list)
    modes: list[ModeSpan] = field(default_factory=list)
    moments: list[TracedMoment] = field(default_factory=list)
    drives: list[EndedDrive] = field(default_factory=list)
    left_out: int = 0
    """The modes, moments, drives and wanted paths that are not kept."""

    commanded_linear: Series = field(init=False)
    commanded_angular: Series = field(init=False)
    linear: Series = field(init=False)
    angular: Series = field(init=False)
    error: Series = field(init=False)
    battery: Series = field(init=False)
    lateness: Series = field(init=False)
    rates: Rates = field(init=False)

    def __post_init__(self) -> None:
        self.commanded_linear = Series(self.duration_s)
        self.commanded_angular = Series(self.duration_s)
        self.linear = Series(self.duration_s)
        self.angular = Series(self.duration_s)
        self.error = Series(self.duration_s)
        self.battery = Series(self.duration_s)
        self.lateness = Series(self.duration_s)
        self.rates = Rates(self.duration_s)

    def enter_mode(self, t_s: float, mode: str, reason: str) -> None:
        """Note a mode from a time on."""
        if self.modes:
            self.modes[-1].end_s = t_s
            if self.modes[-1].mode == mode and self.modes[-1].reason == reason:
                return
        if self._has_room(self.modes, MAX_SPANS):
            self.modes.append(ModeSpan(t_s, t_s, mode, reason))

    def happened(self, t_s: float, kind: str, text: str) -> None:
        """Note a moment."""
        if self._has_room(self.moments, MAX_MOMENTS):
            self.moments.append(TracedMoment(t_s, kind, text))

    def drive_ended(self, drive: EndedDrive) -> None:
        """Note the end of a drive."""
        if self._has_room(self.drives, MAX_DRIVES):
            self.drives.append(drive)

    def want(self, outline: list[Point]) -> None:
        """Note a wanted path; one that leads nowhere is left out."""
        has_room = sum(map(len, self.wanted)) + len(outline) <= MAX_WANTED_POINTS
        if outline and has_room and all(is_on_earth(x, y) for x, y in outline):
            self.wanted.append(outline)
        else:
            self.left_out += 1

    def close(self) -> None:
        """Let the last mode last to the end."""
        if self.modes:
            self.modes[-1].end_s = max(self.duration_s, self.modes[-1].begin_s)

    def series(self) -> Iterator[Series]:
        """Yield every series."""
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

    Commands, modes and ends are those that were recorded. A kernel decides the events again, for
    only it knows the wanted path; where entries are missing it waits for the next snapshot.
    """

    def __init__(self, traces: Traces) -> None:
        self._traces = traces
        self._kernel: Kernel | None = None
        self._next_seq: int | None = None
        self._tick_ns: int | None = None
        self._outlined: tuple[int, Pose] | None = None

    def take(self, entry: JournalEntry, t_s: float) -> None:
        """Take an entry that was recorded at this time.

        Raises:
            UnreadableFile: It is not of this version; the next entry may be taken.
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
                    self._follow_safely(odometry.pose, t_s)
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

    def _follow_safely(self, pose: Pose, t_s: float) -> None:
        """Follow a drive of a state that came from a file, which may be none that a kernel has."""
        try:
            self._follow(pose, t_s)
        except KERNEL_FAILURES as error:
            self._kernel = None
            raise UnreadableFile(f"the wanted path cannot be drawn: {error}"[:200]) from None

    def _follow(self, pose: Pose, t_s: float) -> None:
        """Note how far a robot at this pose is from its path, and a path that is new."""
        state = None if self._kernel is None else self._kernel.state
        if state is None or state.drive is None or state.phase is not Phase.DRIVING:
            return
        drive = state.drive
        if not drive.path.segments:
            return
        self._traces.error.add(t_s, drive.cross_track_m(pose))
        if self._outlined != (drive.request_id, drive.origin):
            self._outlined = drive.request_id, drive.origin
            outline = map(drive.origin.compose, drive.path.outline())
            self._traces.want([(place.x, place.y) for place in outline])

    def _measured(self, ended: DriveEnded) -> DriveReport:
        """Return the report of a drive, without errors if it has no path."""
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
"""Takes a message into traces, with its time and its bytes."""


@dataclass(frozen=True, slots=True)
class TopicTraces:
    """What takes the messages of each topic that is drawn, by topic and type."""

    takers: dict[tuple[str, str], Taker]

    def take(self, message: Message, traces: Traces, t_s: float) -> None:
        """Take a message; those of other topics are ignored."""
        taker = self.takers.get((message.topic, message.type_name))
        if taker is not None:
            taker(traces, t_s, message.data)

    @property
    def topics(self) -> list[str]:
        """The topics that are drawn."""
        return [topic for topic, _ in self.takers]


def topic_traces(topics: Sequence[TopicInfo]) -> TopicTraces:
    """Choose the topics to draw: of each kind the one with the most messages."""
    takers: dict[tuple[str, str], Taker] = {}
    kinds: tuple[dict[str, Taker], ...] = (
        {ODOMETRY: _take_odometry},
        {TWIST: _take_command, TWIST_STAMPED: _take_stamped_command},
        {BATTERY: _take_battery},
    )
    for kind in kinds:
        found = [each for each in topics if each.type_name in kind and each.message_count]
        if found:
            chosen = max(found, key=lambda each: each.message_count)
            takers[chosen.name, chosen.type_name] = kind[chosen.type_name]
    return TopicTraces(takers)


def _take_odometry(traces: Traces, t_s: float, data: bytes) -> None:
    sample = read_sample(data)
    traces.driven.add(t_s, sample.x, sample.y)
    traces.linear.add(t_s, sample.linear)
    traces.angular.add(t_s, sample.angular)


def _take_command(traces: Traces, t_s: float, data: bytes) -> None:
    _add_command(traces, t_s, data, stamped=False)


def _take_stamped_command(traces: Traces, t_s: float, data: bytes) -> None:
    _add_command(traces, t_s, data, stamped=True)


def _add_command(traces: Traces, t_s: float, data: bytes, *, stamped: bool) -> None:
    try:
        twist = decode_twist_stamped(data) if stamped else decode_twist(data)
    except struct.error:
        traces.commanded_linear.odd += 1
        return
    traces.commanded_linear.add(t_s, twist.linear)
    traces.commanded_angular.add(t_s, twist.angular)


def _take_battery(traces: Traces, t_s: float, data: bytes) -> None:
    traces.battery.add(t_s, 100.0 * read_battery_level(data))
