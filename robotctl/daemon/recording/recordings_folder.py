"""The recordings folder: its retention policy, and the new recording in it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from robotctl.base.errors import RobotctlError
from robotctl.base.paths import make_private, recordings_note_path
from robotctl.config import Config, RecordingParams, flat
from robotctl.daemon.recording.provenance import provenance, software
from robotctl.decisions.journal import head_of, log_folder
from robotctl.kernel.units import DAY_S
from robotctl.recording import Recorder, RecorderOptions
from robotctl.recording.format.names import (
    FOXGLOVE_RECORD,
    PARAMETER_PREFIX,
    SOFTWARE_RECORD,
)
from robotctl.recording.keep.retention import RetentionPolicy
from robotctl.recording.write.mcap_writer import Sealer


def retention_policy(params: RecordingParams) -> RetentionPolicy:
    """Return the configured retention policy; 0 in the configuration means no limit."""
    return RetentionPolicy(
        round(params.max_total_gb * 1e9) or None, params.max_age_days * DAY_S or None
    )


def save_recordings_path(recordings: Path, robot: str) -> list[str]:
    """Save the path of the recordings for later commands; return [], or a note on a failure."""
    note = recordings_note_path(robot)
    try:
        make_private(note.parent)
        unfinished = note.with_suffix(".new")
        unfinished.write_text(f"{recordings}\n", encoding="utf-8")
        unfinished.replace(note)
    except (OSError, UnicodeEncodeError, RobotctlError) as error:
        return [f"`robotctl recordings` will not find {recordings}: {error}"]
    return []


def open_recorder(
    recordings: Path,
    robot: str,
    config: Config,
    mode: Callable[[], str],
    on_failure: Callable[[str], None],
    on_split: Callable[[Path], None],
    on_full: Callable[[Path], None],
    *,
    present: Callable[[], Config] | None = None,
    sealer: Sealer | None = None,
    evidence: frozenset[str] = frozenset(),
    names: Mapping[str, str] | None = None,
) -> Recorder:
    """Start the recording ROBOT_DATE_TIME.

    The callbacks may be called in any thread. For the metadata of each file, `mode()` returns the
    robot's mode, and `present()` the configuration, which is `config` if `present` is None.
    `on_failure(detail)` is called when recording fails, `on_split(file)` when the next file begins,
    and `on_full(file)` when a file is full: it must schedule a call of the recorder's `split`.
    `sealer` is used if `recording.seal` is set. `evidence` has the full names of topics that checks
    need. `names` has the full names of the daemon's own topics and services, by metadata key.

    Raises:
        Refused: The recording cannot be written.
    """
    described = {"robot": robot, **provenance(), **(names or {})}

    def metadata() -> dict[str, str]:
        values = flat(config if present is None else present())
        parameters = {f"{PARAMETER_PREFIX}{key}": str(value) for key, value in values.items()}
        head = {"decisions": head_of(log_folder(robot))}
        return {"mode": mode(), **described, **head, **parameters}

    records = {SOFTWARE_RECORD: software(), FOXGLOVE_RECORD: {"deviceName": robot}}
    return Recorder(
        _new_folder(recordings, f"{robot}_{time.strftime('%Y%m%d_%H%M%S')}"),
        RecorderOptions(
            compression=config.recording.compression,
            group_readable=config.recording.group_readable,
            sealer=sealer if config.recording.seal else None,
            evidence=evidence,
            records=records,
        ),
        metadata=metadata,
        on_failure=on_failure,
        on_split=on_split,
        on_full=on_full,
    )


def _new_folder(recordings: Path, name: str) -> Path:
    folder, attempt = recordings / name, 1
    while os.path.lexists(folder):
        attempt += 1
        folder = recordings / f"{name}-{attempt}"
    return folder
