"""Cuts one clip: waits until its whole time range is recorded, and chooses a file name."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from robotctl.base.errors import Refused
from robotctl.base.processes.pipes import Report
from robotctl.base.store.remote_file import RemoteFile
from robotctl.kernel.units import NS_PER_S
from robotctl.recording.disk.access import is_shared, make_folder
from robotctl.recording.format.names import EventKind
from robotctl.recording.keep.clip import Clip, Moment, Progress, cut_clip
from robotctl.recording.keep.listing import CLIPS_FOLDER, ListedRecording, list_recording
from robotctl.recording.read.reader import Recording

PATIENCE_S = 3.0
"""How long to wait for messages of a live recording after they are due [s]."""

_LOOK_AGAIN_S = 0.1


@dataclass(frozen=True, slots=True)
class ClipJob:
    """What to cut from `source`. Without `target`, the clip goes to the source's clips folder."""

    source: Path
    moment: Moment
    before_s: float
    after_s: float
    target: Path | None = None

    def as_object(self) -> dict[str, Any]:
        """Return the job as a JSON object."""
        moment = self.moment
        return {
            "source": str(self.source),
            "log_ns": moment.log_ns,
            "kind": None if moment.kind is None else moment.kind.value,
            "text": moment.text,
            "before_s": self.before_s,
            "after_s": self.after_s,
            "target": None if self.target is None else str(self.target),
        }

    @classmethod
    def from_object(cls, given: dict[str, Any]) -> Self:
        """Return the job from an object that `as_object` returned."""
        kind, target = given["kind"], given["target"]
        return cls(
            Path(given["source"]),
            Moment(given["log_ns"], None if kind is None else EventKind(kind), given["text"]),
            given["before_s"],
            given["after_s"],
            None if target is None else Path(target),
        )

    @property
    def end_ns(self) -> int:
        """End of the clip [ns since the epoch]."""
        return self.moment.log_ns + round(self.after_s * NS_PER_S)


def remaining_s(job: ClipJob, listed: ListedRecording) -> float:
    """Return how long the recording must continue until it contains the whole clip [s]."""
    if not listed.live or listed.end_ns >= job.end_ns:
        return 0.0
    return max(job.end_ns - time.time_ns(), 0) / NS_PER_S


def make_clip(job: ClipJob, on_progress: Progress = lambda done, total: None) -> Clip:
    """Wait until the recording contains the clip, has ended or is PATIENCE_S late; then cut it.

    Raises:
        Refused: As `cut_clip` raises it.
        UnreadableFile: The recording cannot be read.
    """
    _wait_for_end(job)
    target = job.target or _free_name(job)
    with Recording(job.source) as recording:
        return cut_clip(
            recording,
            job.moment,
            (max(job.moment.log_ns - round(job.before_s * NS_PER_S), 0), job.end_ns),
            target,
            on_progress,
        )


def clip_job(given: dict[str, Any], report: Report) -> None:
    """Cut the clip of a job in a separate process; report {"target", "lost"}."""
    made = make_clip(ClipJob.from_object(given))
    report({"target": str(made.target), "lost": list(made.lost)})


def _wait_for_end(job: ClipJob) -> None:
    due_s = min((job.end_ns - time.time_ns()) / NS_PER_S, job.after_s)  # the clock may be set back
    deadline = time.monotonic() + due_s + PATIENCE_S
    while time.monotonic() < deadline:
        listed = list_recording(job.source)
        if not listed.live or listed.end_ns >= job.end_ns:
            return
        time.sleep(_LOOK_AGAIN_S)


def _free_name(job: ClipJob) -> Path:
    """Return an unused name in the clips folder of the recording, and create that folder.

    The clip of a file at a URL is written into the working directory.
    """
    source = job.source
    folder = (source if source.is_dir() else source.parent) / CLIPS_FOLDER
    if isinstance(source, RemoteFile):
        folder = Path()
    try:
        if not folder.is_dir():
            make_folder(folder, shared=is_shared(folder.parent))
    except OSError as error:
        raise Refused(
            f"cannot write into {folder}: {error.strerror} (choose another file: -o FILE)"
        ) from error
    at = time.strftime("%H%M%S", time.localtime(job.moment.log_ns // NS_PER_S))
    kind = "at" if job.moment.kind is None else job.moment.kind.value
    name, attempt = f"{source.stem}_{kind}_{at}", 1
    target = folder / f"{name}.mcap"
    while os.path.lexists(target):
        attempt += 1
        target = folder / f"{name}-{attempt}.mcap"
    return target
