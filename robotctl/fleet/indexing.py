"""Makes the indexes of recordings that have none, or an old one, in processes of their own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from robotctl.errors import RobotctlError
from robotctl.fleet.history import rows_of
from robotctl.fleet.index_file import files_of, index_path, stamp_of, write_index
from robotctl.fleet.jobs import Done, local_processes, results_of
from robotctl.recording.disk.storage import is_being_written
from robotctl.recording.read.files import natural_order
from robotctl.recording.read.verified import verify_recording
from robotctl.rerun.check import check_recording

Failures = dict[Path, str]
"""Recordings that could not be indexed, each with the reason."""


NOT_CHECKED: Final = "not checked"
"""The verdicts of a recording that goes on: it is checked and verified when it is complete."""


def closed_files(files: Iterable[Path]) -> list[Path]:
    """Return those files of a recording that no process is writing any more, in their order.

    Raises:
        OSError: One cannot be opened.
    """
    return [each for each in sorted(files, key=natural_order) if not is_being_written(each)]


def index_recording(recording: Path) -> str:
    """Write the index of a recording, with its verdicts; return why that failed, or "".

    Of a recording that goes on, the closed files are indexed. It runs in another process, so that
    it returns its error as a text.
    """
    try:
        files = files_of(recording)
        closed = closed_files(files)
        stamp = stamp_of(closed)
        if len(closed) < len(files):
            rows = rows_of(recording, NOT_CHECKED, None, NOT_CHECKED, closed)
        else:
            verify = verify_recording(recording).proof.value
            report = check_recording(recording)
            says = [each.text for each in report.violations] + report.missing
            rows = rows_of(recording, report.verdict.value, says[0] if says else None, verify)
        write_index(index_path(recording), recording.name, rows, stamp)
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
