"""Makes the indexes of recordings that have none, or an old one, in processes of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robotctl.fleet.jobs import Done

Failures = dict[Path, str]
"""Recordings that could not be indexed, each with the reason."""


def index_recordings(
    recordings: Sequence[Path], on_progress: Done = lambda done, total: None
) -> Failures:
    """Index recordings, a process per processor, and return those that failed."""
    # A question about indexed recordings needs neither processes nor the kernel.
    from robotctl.fleet.jobs import local_processes, results_of
    from robotctl.fleet.recording_index import index_recording

    results = results_of(index_recording, recordings, local_processes, on_progress)
    return {
        path: "the process that indexed it was killed" if said is None else said
        for path, said in results
        if said != ""
    }
