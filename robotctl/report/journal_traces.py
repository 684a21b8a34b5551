"""The traces of a recording with a journal: its events, decided again, and its recorded effects."""

from __future__ import annotations

from typing import Final

from robotctl.errors import UnreadableFile
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
from robotctl.recording.format.event_kind import EventKind
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.format.noted_events import NOTED_MODES
from robotctl.report.traces import EndedDrive, Traces
from robotctl.rerun.journal_values import (
    KERNEL_FAILURES,
    decide,
    read_effect,
    read_event,
    read_snapshot,
)
from robotctl.rerun.sentences import sentence_of

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
