"""Tidying a recordings folder: what is too old or too much goes, what a crash left is repaired."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from fcntl import LOCK_EX, flock
from pathlib import Path
from typing import Any, Self

from robotctl.recording.repair import repair
from robotctl.recording.retention import RetentionPolicy, enforce
from robotctl.recording.tidied import Tidied


@dataclass(frozen=True, slots=True)
class TidyJob:
    """Which folder to tidy, and how much to keep in it."""

    recordings: Path
    policy: RetentionPolicy

    def to_json(self) -> str:
        """One line."""
        return json.dumps({"recordings": str(self.recordings), "policy": asdict(self.policy)})

    @classmethod
    def from_json(cls, line: str) -> Self:
        """The job in a line of `to_json`."""
        given: dict[str, Any] = json.loads(line)
        return cls(Path(given["recordings"]), RetentionPolicy(**given["policy"]))


def tidy(job: TidyJob) -> Iterator[Tidied]:
    """Remove first, then repair what is left; yield each thing as it is done. Blocks.

    Waits for whoever else tidies the folder. A file that is being written is not touched.
    """
    recordings = job.recordings
    try:
        with _alone_in(recordings):
            yield from remove_oldest(recordings, job.policy)
            yield from repair(recordings)
    except Exception as error:  # noqa: BLE001 - files of any origin; ours to read, not to trust
        yield _failed(recordings, error)


def remove_oldest(recordings: Path, policy: RetentionPolicy) -> list[Tidied]:
    """Remove what is too old or too much. Blocks."""
    try:
        removed = enforce(recordings, policy, time.time())
    except Exception as error:  # noqa: BLE001 - files of any origin; ours to read, not to trust
        return [_failed(recordings, error)]
    return [Tidied(f"removed for its age or the space: {each.path}") for each in removed]


def _failed(recordings: Path, error: Exception) -> Tidied:
    text = f"{recordings} could not be tidied: {type(error).__name__}: {error}"
    return Tidied(text, problem=True)


@contextmanager
def _alone_in(recordings: Path) -> Iterator[None]:
    """Wait until no other process tidies the folder. Raises OSError."""
    folder = os.open(recordings, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        flock(folder, LOCK_EX)
        yield
    finally:
        os.close(folder)
