"""Simulates a recorded run again: the same parameters and requests, with a simulated robot.

Time is virtual, so no scheduler has an influence: two runs differ only by their parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

from robotctl.config import Config, flat
from robotctl.errors import UnreadableFile
from robotctl.kernel.health import CommandTopic
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.lease import LeaseLost, LeaseRequested
from robotctl.kernel.parameter_change import ParameterRequested
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.state import State
from robotctl.kernel.types import (
    DriveEnded,
    DriveReport,
    DriveRequested,
    Event,
    GuardedCommandReceived,
    ModeRequested,
    ResetRequested,
)
from robotctl.kernel.units import NS_PER_S
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind, JournalEntry
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import read_journal
from robotctl.rerun.closed_loop import closed_loop
from robotctl.rerun.journal_values import read_effect, read_event, read_snapshot
from robotctl.rerun.recorded_settings import Settings, changed, simulated

MAX_REQUESTS = 100_000
"""The largest number of requests that are repeated; the result says if there were more."""

MAX_SPAN_NS = 7 * 86_400 * NS_PER_S
"""The longest recording that is simulated."""

LONGEST = 10
"""A drive that continues at the end is simulated for at most this many times the recording."""

_REPEATED = (
    ModeRequested,
    ResetRequested,
    DriveRequested,
    ParameterRequested,
    LeaseRequested,
    LeaseLost,
    GuardedCommandReceived,
)
_REQUESTS = frozenset(kind.__name__ for kind in _REPEATED)


@dataclass(slots=True)
class Run:
    """The requests of a run, and the results of its drives by the id of their request."""

    begin_ns: int = 0
    end_ns: int = 0
    requests: dict[int, Event] = field(default_factory=dict)
    drives: dict[int, dict[str, Any]] = field(default_factory=dict)

    def end_drive(self, ended: DriveEnded, t_ns: int) -> None:
        """Keep the result of a drive; a drive that began before the recording has no duration."""
        request = self.requests.get(ended.request_id)
        duration_s = (t_ns - request.t_ns) / NS_PER_S if request else None
        self.drives[ended.request_id] = {
            "duration_s": duration_s,
            "completed": ended.completed,
            "reason": ended.reason,
            **_figures(ended.report),
        }


def resimulate(
    path: Path,
    settings: Settings,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, Any]:
    """Simulate a recording again, and return the JSON object of `replay --resim --json`.

    With `settings` a second simulation runs with them. `on_progress` is called with the simulated
    time and the length of the recording [ns].

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
                _take(recorded, entry)
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
    return {
        "path": str(path),
        "duration_s": (recorded.end_ns - recorded.begin_ns) / NS_PER_S,
        "settings": {
            key: {"recorded": flat(config)[key], "what_if": flat(other)[key]} for key in settings
        },
        "drives": [
            {
                "request_id": request_id,
                "recorded": recorded.drives.get(request_id),
                "simulated": again.drives.get(request_id),
                "what_if": what_if.drives.get(request_id) if what_if else None,
            }
            for request_id in sorted(
                recorded.drives.keys()
                | again.drives.keys()
                | (what_if.drives.keys() if what_if else set())
            )
        ],
        "missing": missing,
    }


def _take(run: Run, entry: JournalEntry) -> None:
    if entry.kind is EntryKind.EVENT and entry.name in _REQUESTS:
        request = read_event(entry)
        assert isinstance(request, _REPEATED)
        if len(run.requests) <= MAX_REQUESTS:
            if isinstance(request, LeaseLost | GuardedCommandReceived):  # without an id
                run.requests[-1 - len(run.requests)] = request
            else:
                run.requests[request.request_id] = request
    elif entry.kind is EntryKind.EFFECT and entry.name == DriveEnded.__name__:
        ended = read_effect(entry)
        assert isinstance(ended, DriveEnded)
        run.end_drive(ended, entry.t_ns)


def _simulate(
    config: Config, state: State, recorded: Run, on_progress: Callable[[int, int], None]
) -> Run:
    """Repeat the requests with a simulated robot until recording and drive have ended.

    Other nodes of the recording are left out.
    """
    alone = replace(state.health, foreign_publishers=(), command_topic=CommandTopic())
    kernel = Kernel(config.kernel, replace(state, health=alone))
    begin_ns, end_ns = recorded.begin_ns, recorded.end_ns
    last_ns = begin_ns + LONGEST * (end_ns - begin_ns)
    run = Run(begin_ns, end_ns, recorded.requests)
    told = 0
    asked = list(recorded.requests.values())[:MAX_REQUESTS]
    for event, effects in closed_loop(kernel, config.sim, asked, begin_ns):
        for effect in effects:
            if isinstance(effect, DriveEnded):
                run.end_drive(effect, event.t_ns)
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
            **_figures(drive.report()),
        }
    return run


def _figures(report: DriveReport) -> dict[str, Any]:
    """Return the figures of a drive as JSON values, None for a figure that is unknown."""
    return {
        "laps": report.laps,
        "distance_m": report.distance_m,
        "cross_track_rms_m": report.cross_track_rms_m,
        "cross_track_max_m": report.cross_track_max_m,
        "closure_m": report.closure_m if isfinite(report.closure_m) else None,
    }
