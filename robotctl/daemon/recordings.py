"""The recordings folder: tidied when a daemon starts, and one recording opened in it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from robotctl import __version__
from robotctl.config import Config, RecordingParams, flat
from robotctl.recording.recorder import Compression, Recorder, RecorderOptions
from robotctl.recording.repair import repair
from robotctl.recording.retention import DAY_S, RetentionPolicy, enforce


def tidy(recordings: Path, params: RecordingParams) -> list[str]:
    """Repair what a killed daemon left, remove what is too old; a sentence for each.

    Blocks. A recording that cannot be tidied does not keep the robot from starting.
    """
    if not recordings.is_dir():
        return []
    try:
        done = [f"repaired: {sentence}" for sentence in repair(recordings)]
        policy = RetentionPolicy(
            round(params.max_total_gb * 1e9) or None, params.max_age_days * DAY_S or None
        )
        removed = enforce(recordings, policy, time.time())
        return [*done, *(f"removed for its age or the space: {item.path}" for item in removed)]
    except Exception as error:  # noqa: BLE001 - files of any origin; ours to read, not to trust
        return [f"{recordings} could not be tidied: {type(error).__name__}: {error}"]


def open_recorder(
    recordings: Path,
    robot: str,
    config: Config,
    on_failure: Callable[[str], None],
    on_split: Callable[[Path], None],
) -> Recorder:
    """Begin the recording ROBOT_DATE_TIME; raises Refused where nothing can be written."""
    compression = Compression.ZSTD if config.recording.compression == "zstd" else Compression.NONE
    parameters = {f"parameter.{key}": str(value) for key, value in flat(config).items()}
    return Recorder(
        _new_folder(recordings, f"{robot}_{time.strftime('%Y%m%d_%H%M%S')}"),
        RecorderOptions(compression=compression),
        metadata={
            "robotctl": __version__,
            "robot": robot,
            "host": os.uname().nodename,
            **parameters,
        },
        on_failure=on_failure,
        on_split=on_split,
    )


def _new_folder(recordings: Path, name: str) -> Path:
    folder, attempt = recordings / name, 1
    while os.path.lexists(folder):
        attempt += 1
        folder = recordings / f"{name}-{attempt}"
    return folder
