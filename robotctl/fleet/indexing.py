"""Makes the indexes of recordings that have none, or an old one, in processes of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from robotctl.errors import RobotctlError
from robotctl.fleet.history import rows_of
from robotctl.fleet.index_file import stamp_of, write_index
from robotctl.fleet.jobs import Done, local_processes, results_of
from robotctl.recording.read.verified import verify_recording
from robotctl.rerun.check import check_recording

Failures = dict[Path, str]
"""Recordings that could not be indexed, each with the reason."""


def index_recording(recording: Path) -> str:
    """Check and verify a recording and write its index; return why that failed, or "".

    It runs in another process, so that it returns its error as a text.
    """
    try:
        stamp = stamp_of(recording)
        verify = verify_recording(recording).proof.value
        report = check_recording(recording)
        says = [each.text for each in report.violations] + report.missing
        rows = rows_of(recording, report.verdict.value, says[0] if says else None, verify)
        write_index(recording, rows, stamp)
    except (RobotctlError, OSError) as error:
        return str(error)
    return ""


def index_recordings(
    recordings: Sequence[Path], on_progress: Done = lambda done, total: None
) -> Failures:
    """Index recordings, a process per processor, and return those that failed."""
    results = results_of(index_recording, recordings, local_processes, on_progress)
    return {
        path: "the process that indexed it was killed" if said is None else said
        for path, said in results
        if said != ""
    }
