"""Simulate a recorded run again: a closed loop of kernel and simulated robot in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from robotctl.base.errors import UnreadableFile
from robotctl.check.journal import decide, read_effect, read_event, read_snapshot
from robotctl.check.what_if import Settings, changed, simulated
from robotctl.config import Config, flat
from robotctl.kernel.codec import Snapshot, finite_or_none
from robotctl.kernel.constants import DAY_S, NS_PER_S
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.modes import Mode
from robotctl.kernel.params import BatteryScale
from robotctl.kernel.state import (
    CommandTopic,
    State,
    counts_in_percent,
    full_level,
    is_level,
    level_of,
)
from robotctl.kernel.types import (
    BatteryReceived,
    DriveEnded,
    DriveReport,
    DriveRequested,
    Effect,
    Event,
    GuardedCommandReceived,
    HoldReceived,
    LeaseLost,
    LeaseRequested,
    LifecycleChanged,
    ModeRequested,
    Odometry,
    OdomReceived,
    ParameterRequested,
    PublishTwist,
    Reply,
    ResetRequested,
    Tick,
)
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import read_journal
from robotctl.sim import Robot, SimParams

TICK_AFTER_ODOMETRY_NS = 1_000_000
"""The delay of ticks after odometry; tracking is best with fresh odometry."""


@dataclass(frozen=True, slots=True)
class Start:
    """The first recorded odometry and battery level (0..1), for a kernel that knows none yet."""

    odometry: Odometry | None = None
    battery: float | None = None


def closed_loop(
    kernel: Kernel, sim: SimParams, requests: Iterable[Event], begin_ns: int, start: Start = Start()
) -> Iterator[tuple[Event, tuple[Effect, ...]]]:
    """Yield every event with its effects from `begin_ns` (steady) on, without end.

    `requests` are ordered by time, and each reaches the kernel at its `t_ns`. The robot begins in
    the kernel's state; `start` replaces an unknown odometry or battery level.

    Raises:
        UnreadableFile: The kernel cannot continue from its state.
    """
    robot = Robot(sim)
    health = kernel.state.health
    known = health.odometry or start.odometry
    if known is not None:
        robot.resume(known.pose, known.velocity, kernel.state.command)
    level = health.battery_level if is_level(health.battery_level) else start.battery
    if is_level(level):
        robot.battery = min(level, 1.0)
    stamp_ns = health.odometry_stamp_ns - begin_ns
    source = health.odometry_sources.followed
    full = 100.0 if health.battery_in_percent else full_level(kernel.params.battery.scale)
    odometry_ns = round(NS_PER_S / sim.odometry_rate_hz)
    tick_ns = round(NS_PER_S / kernel.params.rate_hz)
    next_odometry_ns = next_battery_ns = begin_ns
    next_tick_ns = begin_ns + TICK_AFTER_ODOMETRY_NS
    asked = iter(requests)
    request = next(asked, None)
    event: Event
    while True:
        t_ns = min(next_odometry_ns, next_tick_ns, next_battery_ns)
        if request is not None and request.t_ns < t_ns:
            event, request = request, next(asked, None)
        elif t_ns == next_odometry_ns:
            next_odometry_ns += odometry_ns
            robot.advance(1.0 / sim.odometry_rate_hz)
            measured = Odometry(robot.odometry, robot.measured, stamp_ns + t_ns)
            event = OdomReceived(t_ns, measured, source)
        elif t_ns == next_battery_ns:
            next_battery_ns += NS_PER_S
            event = BatteryReceived(t_ns, full * robot.battery)
        else:
            next_tick_ns += tick_ns
            event = Tick(t_ns)
        effects = decide(kernel, event)
        for effect in effects:
            if isinstance(effect, PublishTwist):
                robot.command(effect.twist)
        yield event, effects


MAX_REQUESTS: Final = 100_000
"""The maximum number of repeated requests; `missing` of the result reports more."""

_WITHOUT_ID = (LeaseLost, GuardedCommandReceived, HoldReceived, LifecycleChanged)
_REPEATED = (
    *(ModeRequested, ResetRequested, DriveRequested, ParameterRequested, LeaseRequested),
    *_WITHOUT_ID,
)
_REQUESTS = frozenset(kind.__name__ for kind in _REPEATED)
_RESULTS = frozenset(kind.__name__ for kind in (DriveEnded, Reply))


@dataclass(slots=True)
class Run:
    """The requests of a recorded or simulated run, and their outcomes.

    `refused` has the text of each refusal, `drives` the figures of each ended drive. Their keys are
    the request ids, or negative numbers for requests without id.
    """

    begin_ns: int = 0
    end_ns: int = 0
    requests: dict[int, Event] = field(default_factory=dict)
    refused: dict[int, str] = field(default_factory=dict)
    drives: dict[int, dict[str, Any]] = field(default_factory=dict)
    start: Start = field(default_factory=Start)

    def read(self, entry: JournalEntry, scale: BatteryScale) -> None:
        """Add the request, result or start value in an entry of the journal; ignore other entries.

        Raises:
            UnreadableFile: The entry is not of this version.
        """
        if entry.kind is EntryKind.EFFECT:
            if entry.name in _RESULTS:
                self.effect(read_effect(entry), entry.t_ns)
        elif entry.name in _REQUESTS:
            self._request(read_event(entry))
        elif entry.name == OdomReceived.__name__ and self.start.odometry is None:
            event = read_event(entry)
            assert isinstance(event, OdomReceived)
            self.start = Start(event.odometry, self.start.battery)
        elif entry.name == BatteryReceived.__name__ and self.start.battery is None:
            event = read_event(entry)
            assert isinstance(event, BatteryReceived)
            level = level_of(event.level, counts_in_percent(event.level, False, scale))
            self.start = Start(self.start.odometry, level)

    def _request(self, event: Event) -> None:
        if len(self.requests) > MAX_REQUESTS:
            return
        if isinstance(event, _WITHOUT_ID):
            self.requests[-1 - len(self.requests)] = event
        else:
            assert isinstance(event, _REPEATED)
            self.requests[event.request_id] = event

    def effect(self, effect: Effect, t_ns: int) -> None:
        """Add `effect`, at steady time `t_ns`, if it refuses a request or ends a drive."""
        if isinstance(effect, Reply) and not effect.ok and effect.request_id in self.requests:
            self.refused[effect.request_id] = effect.message
        elif isinstance(effect, DriveEnded):
            request = self.requests.get(effect.request_id)
            duration_s = (t_ns - request.t_ns) / NS_PER_S if request else None
            report = effect.report
            if isinstance(request, DriveRequested) and request.course.held is not None:
                report = report.without_errors()
            self.drives[effect.request_id] = {
                "duration_s": duration_s,
                "completed": effect.completed,
                "reason": effect.reason,
                **figures(report),
            }

    def refused_drives(self) -> set[int]:
        """Return the ids of the refused requests for a motion."""
        asked = {each: self.requests[each] for each in self.refused}
        return {
            number
            for number, request in asked.items()
            if isinstance(request, DriveRequested)
            or (isinstance(request, ModeRequested) and request.requested == Mode.MOVING.value)
        }


def figures(report: DriveReport) -> dict[str, Any]:
    """Return the figures of a drive as JSON values, None for an unknown figure."""
    return {
        "laps": report.laps,
        "distance_m": report.distance_m,
        "cross_track_rms_m": finite_or_none(report.cross_track_rms_m),
        "cross_track_max_m": finite_or_none(report.cross_track_max_m),
        "closure_m": finite_or_none(report.closure_m),
    }


MAX_SPAN_NS = 7 * round(DAY_S) * NS_PER_S
"""Maximum duration of a recording for a simulation: a week."""

LONGEST = 10
"""Maximum simulated time, as a multiple of the recording's."""


def resimulate(
    path: Path,
    settings: Settings,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Simulate a recording again, and return the JSON object of `replay --resim --json`.

    With `settings`, simulate it a second time with them. `on_progress` gets the simulated time and
    the length of the recording [ns].

    Raises:
        UnreadableFile: The journal has no snapshot to begin from, or its times are impossible.
        ConfigError: The settings do not fit the recorded parameters.
    """
    missing: list[str] = []
    recorded = Run()
    snapshot: Snapshot | None = None
    with Recording(path) as recording:
        for sentence in recording.missing:
            note_missing(missing, sentence)
        info = recording.info()
        for _, entry in read_journal(recording, lambda text: note_missing(missing, text)):
            recorded.end_ns = entry.t_ns
            if entry.kind is EntryKind.SNAPSHOT and snapshot is None:
                snapshot, recorded.begin_ns = read_snapshot(entry), entry.t_ns
            elif snapshot is not None:
                recorded.read(entry, snapshot.params.battery.scale)
    if snapshot is None:
        raise UnreadableFile(f"{path}: its journal holds no snapshot of the kernel to begin from")
    if not 0 <= recorded.end_ns - recorded.begin_ns <= MAX_SPAN_NS:
        raise UnreadableFile(f"{path}: its journal claims to be longer than a week, or runs back")
    if len(recorded.requests) > MAX_REQUESTS:
        note_missing(missing, f"only the first {MAX_REQUESTS} requests are asked again")
    config, unknown = simulated(Config(kernel=snapshot.params), info)
    for key in unknown:
        note_missing(missing, f"the recorded parameter {key} is not known here")
    other = changed(config, settings)
    again = _simulate(config, snapshot.state, recorded, on_progress)
    what_if = _simulate(other, snapshot.state, recorded, on_progress) if settings else None
    runs = (("recorded", recorded), ("simulated", again), ("what_if", what_if))
    asked = {
        request_id
        for _, run in runs
        if run is not None
        for request_id in run.drives.keys() | run.refused_drives()
    }
    return {
        "path": str(path),
        "duration_s": (recorded.end_ns - recorded.begin_ns) / NS_PER_S,
        "settings": {
            key: {"recorded": flat(config)[key], "what_if": flat(other)[key]} for key in settings
        },
        "drives": [
            {
                "request_id": request_id,
                **{side: None if run is None else run.drives.get(request_id) for side, run in runs},
                "no_drive": {
                    side: _no_drive(run, recorded, request_id)
                    for side, run in runs
                    if run is not None and request_id not in run.drives
                },
            }
            for request_id in sorted(asked)
        ],
        "missing": missing,
    }


def _no_drive(run: Run, recorded: Run, request_id: int) -> str:
    """Return the reason why `run` has no drive with this `request_id`."""
    if request_id in run.refused:
        return f"refused: {run.refused[request_id]}"
    if request_id in recorded.refused:
        return "refused in the recording, and not asked again"
    return "it was not requested while the robot stood ready"


def _simulate(
    config: Config, state: State, recorded: Run, on_progress: Callable[[int, int], None]
) -> Run:
    """Repeat the requests with a simulated robot until the recording and the drive have ended.

    Other nodes, and requests that were refused in the recording, are left out.
    """
    alone = replace(state.health, foreign_publishers=(), command_topic=CommandTopic())
    kernel = Kernel(config.kernel, replace(state, health=alone))
    begin_ns, end_ns = recorded.begin_ns, recorded.end_ns
    last_ns = begin_ns + LONGEST * (end_ns - begin_ns)
    run = Run(begin_ns, end_ns, recorded.requests)
    told = 0
    asked = [event for each, event in recorded.requests.items() if each not in recorded.refused]
    loop = closed_loop(kernel, config.sim, asked[:MAX_REQUESTS], begin_ns, recorded.start)
    for event, effects in loop:
        for effect in effects:
            run.effect(effect, event.t_ns)
        drive = kernel.state.drive
        if event.t_ns > end_ns and (drive is None or not drive.laps or event.t_ns > last_ns):
            break
        if event.t_ns > told + NS_PER_S:
            told = event.t_ns
            on_progress(event.t_ns - begin_ns, end_ns - begin_ns)
    drive = kernel.state.drive
    if drive is not None:
        run.drives[drive.request_id] = {
            "duration_s": None,
            "completed": False,
            "reason": "under way at the end",
            **figures(drive.report(kernel.state.tick_t_ns or drive.begin_t_ns)),
        }
    return run
