"""The recordings folder: retention policy, the new recording in it, reserve of free disk space."""

from __future__ import annotations

import asyncio
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Final

from robotctl.base.errors import RobotctlError
from robotctl.base.paths import make_private, recordings_note_path
from robotctl.config import Config, RecordingParams, flat
from robotctl.daemon.recording.provenance import provenance, software
from robotctl.decisions.journal import head_of, log_folder
from robotctl.kernel.constants import DAY_S
from robotctl.recording import Recorder, RecorderOptions
from robotctl.recording.format.names import FOXGLOVE_RECORD, PARAMETER_PREFIX, SOFTWARE_RECORD
from robotctl.recording.keep.retention import RetentionPolicy
from robotctl.recording.write.mcap_writer import Sealer
from robotctl.recording.write.recorder import MessageGate
from robotctl.recording.write.recorder_options import free_space

_log = logging.getLogger(__name__)

LOOK_S: Final = 2.0

STEP: Final = 0.1
"""Share of the reserve by which the free space falls until one more topic is stopped."""

REOPEN: Final = 1.1
"""Share of the reserve at which topics are recorded again."""

MAX_NAMED: Final = 10


class DiskReserve:
    """Stops recording topics, the heaviest first, while less than `least_bytes` are free.

    `gates` has the message filters of topics that may be stopped. Use only in the loop's thread.
    """

    def __init__(self, least_bytes: int, gates: Mapping[str, Sequence[MessageGate]]) -> None:
        self._least_bytes = least_bytes
        self._gates = gates
        self._free_bytes = 0
        self._unknown = ""
        """Why the free space is unknown, or ""."""

        self._sizes: Mapping[str, int] = {}
        self.stopped: list[str] = []
        """Topics that are not recorded, the first stopped topic first."""

    async def run(
        self, recorder: Recorder, folder: Path, free: Callable[[Path], int] = free_space
    ) -> None:
        """Check the free space every LOOK_S until cancelled; return at once for a reserve of 0."""
        while self._least_bytes:
            try:
                free_bytes = await asyncio.to_thread(free, folder)
            except OSError as error:
                self._unknown = f"the free space of {folder} is not known: {error.strerror}"
            else:
                self._unknown = ""
                self.look(free_bytes, _sizes(recorder))
            await asyncio.sleep(LOOK_S)

    def look(self, free_bytes: int, sizes: Mapping[str, int]) -> None:
        """Stop the topic that grew most in `sizes` if space is low, or resume all topics."""
        self._free_bytes = free_bytes
        grown = {topic: size - self._sizes.get(topic, 0) for topic, size in sizes.items()}
        self._sizes = sizes
        if free_bytes >= REOPEN * self._least_bytes:
            self._reopen()
        elif free_bytes < self._least_bytes * (1.0 - STEP * len(self.stopped)):
            open_topics = [each for each in self._gates if each not in self.stopped]
            heaviest = max(open_topics, key=lambda each: grown.get(each, 0), default="")
            if grown.get(heaviest, 0) > 0:
                self._stop(heaviest)

    def warnings(self) -> Iterator[str]:
        """Yield a sentence for each stopped topic, and one for an unknown free space."""
        if self._unknown:
            yield self._unknown
        for topic in islice(self.stopped, MAX_NAMED):
            yield self._sentence(topic)
        if len(self.stopped) > MAX_NAMED:
            yield f"{len(self.stopped) - MAX_NAMED} more topics are not recorded for that reason"

    def _stop(self, topic: str) -> None:
        self.stopped.append(topic)
        for gate in self._gates[topic]:
            gate.is_shut = True
        _log.warning("%s", self._sentence(topic))

    def _reopen(self) -> None:
        for topic in self.stopped:
            for gate in self._gates[topic]:
                gate.is_shut = False
            _log.info("%s is recorded again", topic)
        self.stopped.clear()

    def _sentence(self, topic: str) -> str:
        free, least = self._free_bytes / 1e9, self._least_bytes / 1e9
        return (
            f"{topic} is not recorded: the disk has {free:.2f} GB free, less than {least:g} GB "
            "(recording.min_free_gb; see robotctl recordings rm)"
        )


def _sizes(recorder: Recorder) -> dict[str, int]:
    sizes: dict[str, int] = {}
    for topic in recorder.stats().topics:
        sizes[topic.name] = sizes.get(topic.name, 0) + topic.bytes
    return sizes


def retention_policy(params: RecordingParams) -> RetentionPolicy:
    """Return the configured retention policy."""
    return RetentionPolicy(
        round(params.max_total_gb * 1e9) or None, params.max_age_days * DAY_S or None
    )


def save_recordings_path(recordings: Path, robot: str) -> list[str]:
    """Save the path of the recordings for later commands; return notes on a failure."""
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
    """Start a recording in a new folder ROBOT_DATE_TIME, and return its recorder.

    Any thread may call the callbacks. `on_full` must schedule a call of the recorder's `split`.
    `evidence` has the full names of topics that checks need. `names` is added to the metadata.

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
