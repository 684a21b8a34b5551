"""Tidies a recordings folder: removes old recordings, repairs those that a crash interrupted."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from robotctl.base.processes.pipes import Report
from robotctl.recording.keep.repair import repair
from robotctl.recording.keep.retention import (
    RetentionPolicy,
    TidyNote,
    enforce_retention,
    noted_removals,
    only_one_in,
)


@dataclass(frozen=True, slots=True)
class TidyJob:
    """Which folder to tidy, how much to keep in it, and whether to repair the rest."""

    recordings: Path
    policy: RetentionPolicy
    repairs: bool

    def as_object(self) -> dict[str, Any]:
        """Return the job as a JSON object."""
        return asdict(self) | {"recordings": str(self.recordings)}

    @classmethod
    def from_object(cls, given: dict[str, Any]) -> Self:
        """Return the job from an object that `as_object` returned."""
        policy = RetentionPolicy(**given["policy"])
        return cls(Path(given["recordings"]), policy, given["repairs"])


def tidy(job: TidyJob) -> Iterator[TidyNote]:
    """Collect noted removals, remove old files, repair the rest; yield a note of each. Blocks.

    Waits for other processes that tidy the folder. Files that are being written are not changed.
    """
    recordings = job.recordings
    try:
        with only_one_in(recordings):
            yield from noted_removals(recordings)
            for removed in enforce_retention(recordings, job.policy, time.time()):
                text = f"removed for its age or to free space: {removed.path}"
                yield TidyNote(text, removed=str(removed.path))
            if job.repairs:
                yield from repair(recordings)
    except Exception as error:  # noqa: BLE001 - files of any origin
        text = f"{recordings} could not be tidied: {type(error).__name__}: {error}"
        yield TidyNote(text, problem=True)


def tidy_job(given: dict[str, Any], report: Report) -> None:
    """Run a job in a separate process, and report each note. If a report fails, stop there."""
    for note in tidy(TidyJob.from_object(given)):
        report(note._asdict())
