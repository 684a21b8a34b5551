"""Simulates a recorded run again: the same parameters and requests, with a simulated robot.

Time is virtual, so no scheduler has an influence: two runs differ only by their parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from robotctl.config import Config, flat
from robotctl.errors import UnreadableFile
from robotctl.kernel.health import CommandTopic
from robotctl.kernel.kernel import Kernel
from robotctl.kernel.snapshot import Snapshot
from robotctl.kernel.state import State
from robotctl.kernel.units import DAY_S, NS_PER_S
from robotctl.recording import Recording
from robotctl.recording.format.journal import EntryKind
from robotctl.recording.read.file_index import note_missing
from robotctl.recording.read.journal_reader import read_journal
from robotctl.rerun.closed_loop import closed_loop
from robotctl.rerun.journal_values import read_snapshot
from robotctl.rerun.recorded_settings import Settings, changed, simulated
from robotctl.rerun.simulated_run import MAX_REQUESTS, Run, figures

MAX_SPAN_NS = 7 * round(DAY_S) * NS_PER_S
"""The longest recording that is simulated."""

LONGEST = 10
"""A drive that continues at the end is simulated for at most this many times the recording."""


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
                recorded.take(entry, snapshot.params.battery.scale)
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
    """Return why a run has no such drive."""
    if request_id in run.refused:
        return f"refused: {run.refused[request_id]}"
    if request_id in recorded.refused:
        return "refused in the recording, and not asked again"
    return "it was not requested while the robot stood ready"


def _simulate(
    config: Config, state: State, recorded: Run, on_progress: Callable[[int, int], None]
) -> Run:
    """Repeat the requests with a simulated robot until recording and drive have ended.

    Other nodes of the recording are left out, and requests that were refused in it.
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
